"""Jobs: what is to be done, how far it is, and its end."""

from fastapi import APIRouter

from nolens.studio.jobs import JobQueue
from nolens.studio.requests import JsonRoute
from nolens.studio.schemas import Job, JobDeclarations, JobId, JobRequest, Jobs


def jobs_router(queue: JobQueue) -> APIRouter:
    """Routes of jobs."""
    router = APIRouter(prefix="/api/jobs", route_class=JsonRoute)

    @router.get("")
    async def jobs() -> Jobs:
        return Jobs(jobs=queue.all())

    @router.post("", status_code=201)
    async def submit(request: JobRequest) -> JobId:
        return JobId(id=(await queue.submit(request)).id)

    @router.get("/options")
    async def options() -> JobDeclarations:
        return await queue.declarations()

    @router.get("/{identity}")
    async def job(identity: str) -> Job:
        return queue.job(identity)

    @router.post("/{identity}/cancel")
    async def cancel(identity: str) -> Job:
        return queue.cancel(identity)

    return router

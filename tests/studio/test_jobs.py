"""Jobs in a process of their own: they run, are cancelled, die, and are found again."""

import asyncio
import itertools
import json
import os
import secrets
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image
from serving import Running, serving, write_own_weights

from nolens.files import read_frame, read_record
from nolens.files.weights import sha256_of_weights
from nolens.studio.jobs import JobQueue, TooManyJobsError
from nolens.studio.schemas import JobRequest
from nolens.studio.workspace import Workspace
from patience import PATIENCE_S


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    work = tmp_path_factory.mktemp("studio")
    random = np.random.default_rng(0)
    (work / "uploads").mkdir()
    spots = (random.random((64, 80)) < 0.01).astype(np.float32)
    np.save(work / "uploads/psf.npy", spots)
    scene = np.zeros((64, 80), np.float32)
    scene[20:40, 30:60] = 1
    spread = np.fft.irfft2(np.fft.rfft2(scene) * np.fft.rfft2(np.fft.ifftshift(spots)), (64, 80))
    np.save(work / "uploads/raw.npy", spread.clip(0).astype(np.float32))
    np.save(work / "uploads/long.npy", random.random((480, 640), np.float32))
    np.save(work / "uploads/long-psf.npy", (random.random((480, 640)) < 1e-3).astype(np.float32))
    with serving(work) as running:
        yield running


RECONSTRUCT = {"measurement": "work/uploads/raw.npy", "psf": "work/uploads/psf.npy"}
LONG = {
    "measurement": "work/uploads/long.npy", "psf": "work/uploads/long-psf.npy",
    "iterations": 100_000, "tolerance": 0, "tau": 1e-4, "support": "480x640",
}  # fmt: skip


def test_reconstruction_runs_with_its_curve_and_files(studio: Running) -> None:
    identity = studio.job("reconstruct", {**RECONSTRUCT, "iterations": 40, "tolerance": 0})
    job = studio.ended(identity)
    assert job["status"] == "done", job
    assert job["title"] == "Reconstruct raw.npy"
    assert [each.rsplit(".", 1)[1] for each in job["outputs"]] == ["png", "tif", "json"]
    rows = job["history"]
    assert [row["iteration"] for row in rows] == list(range(4, 41, 4))
    assert rows[-1]["objective"] < rows[0]["objective"]
    assert job["summary"]["iterations"] == 40
    answer = httpx.get(f"{studio.url}/api/file", params={"path": job["outputs"][0]})
    assert answer.headers["content-disposition"].startswith("inline")
    with Image.open(answer_file(studio, answer)) as picture:
        light = np.asarray(picture.convert("L"), float)
    assert light[20:40, 30:60].mean() > 3 * light[:15].mean() + 1
    record = read_record(studio.work / job["outputs"][2].removeprefix("work/"))
    assert record.result["iterations"] == 40
    weights = write_own_weights(studio.work / "uploads/mine.npz")
    again = studio.ended(
        studio.job("reconstruct", {**RECONSTRUCT, "prior": "work/uploads/mine.npz"})
    )
    assert again["status"] == "done", again
    assert again["outputs"][0] != job["outputs"][0]
    assert again["summary"]["weights_sha256"] == sha256_of_weights(weights)
    kept = studio.get(f"record?path={again['outputs'][2]}")["record"]
    assert kept["parameters"]["prior"] == "work/uploads/mine.npz"


def answer_file(studio: Running, answer: httpx.Response) -> Path:
    path = studio.work / "answer.png"
    path.write_bytes(answer.content)
    return path


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        ("reconstruct", {"measurement": "work/uploads/raw.npy"}, "no psf is given"),
        ("reconstruct", {**RECONSTRUCT, "iterations": "many"}, "iterations is 'many'"),
        ("reconstruct", {**RECONSTRUCT, "iteration": 3}, "there is no option 'iteration'"),
        ("reconstruct", {**RECONSTRUCT, "output": "work/x.png"}, "chosen by the studio"),
        ("reconstruct", {**RECONSTRUCT, "psf": "work/no.npy"}, "there is no work/no.npy"),
        ("reconstruct", {**RECONSTRUCT, "psf": "../x.npy"}, "is no path here"),
        ("reconstruct", {**RECONSTRUCT, "psf": "work/uploads/../../x"}, "is no path here"),
        ("reconstruct", {**RECONSTRUCT, "psf": {"a": 1}}, "give a path"),
        ("reconstruct", {**RECONSTRUCT, "prior": "/etc/mine.npz"}, "is no path here"),
        ("reconstruct", {**RECONSTRUCT, "prior": "mine.npz"}, "is no path here"),
        ("reconstruct", {**RECONSTRUCT, "prior": "work/no.npz"}, "there is no work/no.npz"),
        ("reconstruct", {**RECONSTRUCT, "prior": "mine"}, "prior is 'mine'"),
        ("design-look", {"camera": "/etc"}, "is no path here"),
        ("design-look", {"camera": "etc"}, "there is no camera 'etc'"),
        ("design-look", {"thickness": {"resin": "1"}}, "1 has no unit"),
        ("design-thickness", {"material": ["../../x.toml"]}, "is no path here"),
        ("calibrate", {"frames": ["work/uploads/raw.npy"], "distance": "30cm", "name": "../x"},
         "name is '../x'"),
        ("refocus", {"measurement": "work/uploads/raw.npy"}, "no psfs is given"),
        ("measure-field", {}, "nothing is given to measure"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_told_in_the_commands_words(
    studio: Running, kind: str, options: dict[str, object], words: str
) -> None:
    before = len(studio.get("jobs")["jobs"])
    answer = studio.post("jobs", {"kind": kind, "options": options}, 422)
    assert words in answer["detail"], answer
    assert len(studio.get("jobs")["jobs"]) == before


def test_a_job_that_cannot_go_on_says_why(studio: Running) -> None:
    (studio.work / "uploads/dark.npy").write_bytes(b"no npy")
    job = studio.ended(studio.job("preview", {"path": "work/uploads/dark.npy"}))
    assert job["status"] == "failed"
    assert "dark.npy" in job["error"]


def test_cancelled_job_keeps_the_picture_so_far(studio: Running) -> None:
    identity = studio.job("reconstruct", LONG)
    waiting = studio.job("reconstruct", RECONSTRUCT)
    studio.until(f"jobs/{identity}", lambda job: len(job["history"]) > 2)
    assert studio.get(f"jobs/{waiting}")["status"] == "queued"
    progress = studio.get(f"jobs/{identity}")["progress"]
    assert progress["what"] == "iteration" and 0 < progress["fraction"] < 1
    assert progress["limit"] == 100_000 and progress["seconds_left"] > 1
    studio.post(f"jobs/{identity}/cancel")
    job = studio.ended(identity)
    assert job["status"] == "cancelled"
    png = next(each for each in job["outputs"] if each.endswith(".png"))
    assert (studio.work / png.removeprefix("work/")).is_file()
    assert studio.ended(waiting)["status"] == "done"


def test_cancelled_before_its_turn_it_never_runs(studio: Running) -> None:
    running = studio.job("reconstruct", LONG)
    waiting = studio.job("reconstruct", RECONSTRUCT)
    assert studio.post(f"jobs/{waiting}/cancel")["status"] == "cancelled"
    studio.post(f"jobs/{running}/cancel")
    studio.ended(running)
    assert studio.get(f"jobs/{waiting}")["started"] is None


def test_killed_process_fails_its_job_alone(studio: Running) -> None:
    identity = studio.job("reconstruct", LONG)
    waiting = studio.job("reconstruct", RECONSTRUCT)
    studio.until(f"jobs/{identity}", lambda job: job["history"])
    assert studio.app is not None
    os.kill(studio.app.state.jobs.pid, signal.SIGKILL)
    job = studio.ended(identity)
    assert job["status"] == "failed"
    assert "SIGKILL" in job["error"] and "memory" in job["error"]
    assert studio.get("about")["version"]
    assert studio.ended(waiting)["status"] == "done"


def test_looks_and_previews_go_before_long_work(studio: Running) -> None:
    running = studio.job("reconstruct", LONG)
    waiting = studio.job("reconstruct", RECONSTRUCT)
    brief = studio.job("preview", {"path": "work/uploads/raw.npy"})
    studio.post(f"jobs/{running}/cancel")
    ended = [studio.ended(each) for each in (brief, waiting)]
    assert ended[0]["started"] < ended[1]["started"]
    summary = ended[0]["summary"]
    assert summary["picture"] == ended[0]["outputs"][0] == f"work/jobs/{brief}/preview.png"
    assert (summary["rows"], summary["columns"]) == (64, 80)
    assert sum(summary["histogram"]["grey"]) == 64 * 80


def test_design_is_looked_at(studio: Running) -> None:
    """In focus by the lens equation of its layers, its lines are finer than far out of it."""
    found = {}
    for thickness in ("1.28mm", "0.5mm"):
        options = {"camera": "paper", "thickness": {"resin": thickness}}
        job = studio.ended(studio.job("design-look", options))
        assert job["status"] == "done", job
        found[thickness] = job["summary"]
    sharp, blurred = found.values()
    assert sharp["layers"][0]["thickness_mm"] == 1.28
    resin, glass, gap = (each["index"] for each in sharp["layers"])
    reach_mm = 1 / ((resin - 1) / 0.67 - 1 / 300)
    assert sharp["best_thickness_mm"] == pytest.approx(
        resin * (reach_mm - 0.49 / glass - 0.235 / gap), abs=1e-3
    )
    assert sharp["best_thickness_mm"] == blurred["best_thickness_mm"]
    assert sharp["aperture"] == pytest.approx(0.07 / 2 / reach_mm, rel=1e-4)
    assert 12 < sharp["line_width_um"] < 17  # The paper's prototype has 14.25 um.
    assert blurred["fwhm_um"] > 1.2 * sharp["fwhm_um"]
    assert sharp["autocorrelation"]["value"][0] == pytest.approx(1)
    assert len(sharp["magnitude"]["per_mm"]) == len(sharp["magnitude"]["value"]) > 20
    assert all(0 <= value <= 1 for value in sharp["magnitude"]["value"])
    picture = read_frame(studio.work / sharp["psf"].removeprefix("work/"))
    assert picture.counts.shape == (1, 224, 224)


def test_a_reload_and_a_new_studio_find_all_jobs(studio: Running, tmp_path: Path) -> None:
    (studio.work / "uploads/broken.npy").write_bytes(b"no npy")
    done, failed, cancelled = (
        studio.job(kind, options)
        for kind, options in (
            ("reconstruct", {**RECONSTRUCT, "iterations": 8}),
            ("preview", {"path": "work/uploads/broken.npy"}),
            ("reconstruct", LONG),
        )
    )
    studio.post(f"jobs/{cancelled}/cancel")
    ended = {"done": done, "failed": failed, "cancelled": cancelled}
    for status, identity in ended.items():
        assert studio.ended(identity)["status"] == status
    listed = studio.get("jobs")["jobs"]
    folder = studio.work / "jobs" / "20200101-000000-preview-abcdef"
    folder.mkdir()
    lost: dict[str, object] = {
        "id": folder.name,
        "kind": "preview",
        "title": "Preview x",
        "status": "running",
    }
    lost["progress"] = {"what": "preview", "share": 0.25}  # As the version before wrote it.
    (folder / "job.json").write_text(json.dumps(lost))
    with serving(studio.work) as again:
        found = {each["id"]: each for each in again.get("jobs")["jobs"]}
        assert all(found[each["id"]]["status"] == each["status"] for each in listed)
        assert found[folder.name]["status"] == "failed"
        assert "was stopped" in found[folder.name]["error"]
        assert found[folder.name]["progress"]["fraction"] == 0.25
        assert again.get(f"jobs/{done}") == studio.get(f"jobs/{done}")


def test_unknown_job_is_told(studio: Running) -> None:
    answer = httpx.get(f"{studio.url}/api/jobs/nothing")
    assert answer.status_code == 404 and "there is no job" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no JSON"),
        (b"[" * 100_000, "deep"),
        (b"9" * 5000, "number or key of 5000 characters"),
        (rb'{"id": "bad", "kind": "psf", "title": "\ud800", "status": "done"}', "surrogate"),
        (b'{"id": "bad", "kind": "psf", "title": "x", "status": "done", "ended": NaN}', "NaN"),
        (b'{"id": "bad", "kind": "psf", "title": "x", "status": 1}', "status"),
        (b'{"id": "bad", "kind": "x", "title": "x", "status": "done"}', "the unknown kind 'x'"),
        (b'{"id": "other", "kind": "psf", "title": "x", "status": "done"}', "is the job 'other'"),
    ],
)
def test_a_bad_job_of_an_earlier_run_is_shown_with_its_reason(
    tmp_path: Path, content: bytes, words: str
) -> None:
    folder = tmp_path / "jobs/bad"
    folder.mkdir(parents=True)
    (folder / "job.json").write_bytes(content)
    (tmp_path / "jobs/.hidden").touch()
    [job] = JobQueue(Workspace([tmp_path])).all()
    assert (job.id, job.title, job.status) == ("bad", "bad/job.json", "failed")
    assert words in (job.error or ""), job.error
    assert "work/jobs/bad/job.json" in (job.error or "") and "\n" not in (job.error or "")


class Checking:
    """A process that checks jobs one after the other, and never ends one."""

    async def request(self, *message: object, seconds: float) -> object:
        await asyncio.sleep(0.001)
        return {"psf": {}} if message[0] == "declarations" else None

    def send(self, *message: object) -> None:
        pass

    async def stop(self, grace_s: float) -> None:
        pass


def test_of_many_jobs_at_once_as_many_are_taken_as_may_wait(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each has its place and its name before it is checked: others ask meanwhile."""
    monkeypatch.setattr(JobQueue, "_working", lambda queue: checking)
    checking = Checking()
    drawn = itertools.count()
    monkeypatch.setattr(secrets, "token_hex", lambda _: f"{next(drawn) // 2:04x}")  # Each twice.

    async def ask() -> tuple[list[object], int]:
        queue = JobQueue(Workspace([tmp_path]))
        request = JobRequest(kind="psf", options={"camera": "small"})
        answers = await asyncio.gather(
            *(queue.submit(request) for _ in range(200)), return_exceptions=True
        )
        counted = len(queue.all())
        await queue.close()
        return list(answers), counted

    with ThreadPoolExecutor(1) as pool:  # The browser's tests leave a running loop in this thread.
        answers, counted = pool.submit(asyncio.run, ask()).result()
    refused = [each for each in answers if isinstance(each, TooManyJobsError)]
    assert (counted, len(refused)) == (50, 150)
    assert "50 jobs are waiting already" in str(refused[0])


def test_links_beside_what_a_job_is_given_are_not_followed(studio: Running, tmp_path: Path) -> None:
    np.save(tmp_path / "secret.npy", np.ones((64, 80), np.float32))
    folder = studio.work / "linked"
    folder.mkdir()
    (folder / "1.npy").symlink_to(tmp_path / "secret.npy")
    (folder / "x.tif").symlink_to(tmp_path / "secret.npy")
    (folder / "psfs.toml").write_text(
        'schema_version = 1\n[[psf]]\nfile = "x.tif"\npixel = "3.1 um"\nchannels = ["grey"]\n'
        'distance = "300 mm"\n'
    )
    asked = (
        ("preview", {"path": "work/linked"}),
        ("refocus", {"measurement": "work/uploads/raw.npy", "psfs": "work/linked"}),
    )
    for kind, options in asked:
        answer = httpx.post(
            f"{studio.url}/api/jobs", json={"kind": kind, "options": options}, timeout=PATIENCE_S
        ).json()
        said = answer["detail"] if "detail" in answer else studio.ended(answer["id"])["error"]
        assert "is a link out of its folder, which is not followed" in said

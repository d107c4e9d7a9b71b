"""Many items of work, in processes of this machine or on a cluster, and what is done of them."""

from nolens.engine.items import Outcome, Work, check_scheduler, run_items, worker_count
from nolens.engine.manifest import Manifest

__all__ = ["Manifest", "Outcome", "Work", "check_scheduler", "run_items", "worker_count"]

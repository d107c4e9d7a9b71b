from .chart import chart
from .folder import FolderSource
from .levels import Levels, exposure_for
from .raspberry import RaspberrySource
from .source import CameraSource, Limits, Shot
from .sources import SourceFact, available_sources, open_source
from .twin import TwinSource

__all__ = [
    "CameraSource",
    "FolderSource",
    "Levels",
    "Limits",
    "RaspberrySource",
    "Shot",
    "SourceFact",
    "TwinSource",
    "available_sources",
    "chart",
    "exposure_for",
    "open_source",
]

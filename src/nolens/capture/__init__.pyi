from .exposure import Burst, Levels, exposure_for, fitting_exposure
from .folder import FolderSource
from .raspberry import RaspberrySource
from .series import FrameNames, FrameSeries, SeriesCapture, TakenFrame
from .source import BurstSource, CameraSource, Limits, Shot, available_sources, open_source
from .twin import TwinSource, chart

__all__ = [
    "Burst",
    "BurstSource",
    "CameraSource",
    "FolderSource",
    "FrameNames",
    "FrameSeries",
    "Levels",
    "Limits",
    "RaspberrySource",
    "SeriesCapture",
    "Shot",
    "TakenFrame",
    "TwinSource",
    "available_sources",
    "chart",
    "exposure_for",
    "fitting_exposure",
    "open_source",
]

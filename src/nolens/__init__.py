"""A toolchain for lensless cameras: from a raw measurement and a PSF to the photograph."""

TYPE_CHECKING = False  # As in `typing`, which need not be loaded for it.
if TYPE_CHECKING:
    __version__: str
else:

    def __getattr__(name: str) -> str:
        # Looking the version up loads much, and the command is to reach its own lines soon.
        if name != "__version__":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib.metadata import version

        return version("nolens")

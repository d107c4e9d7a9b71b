"""A toolchain for lensless cameras: from a raw measurement and a PSF to the photograph.

``import nolens as nl`` gives the functions of `nolens.api`; ``__init__.pyi`` lists them.
"""


def __getattr__(name: str) -> object:
    # Nothing is loaded before it is asked for: the command is to reach its own lines soon.
    if name == "__version__":
        from importlib.metadata import version

        return version("nolens")
    if name.startswith("__"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _exports()[0](name)


def __dir__() -> list[str]:
    return [*_exports()[2], "__version__"]


def _exports():
    """Access, list and names of what the stub beside this file exports."""
    import lazy_loader

    return lazy_loader.attach_stub(__name__, __file__)

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
    return _front_door()[0](name)


def __dir__() -> list[str]:
    return [*_front_door()[2], "__version__"]


def _front_door() -> tuple:  # type: ignore[type-arg]
    import lazy_loader

    return lazy_loader.attach_stub(__name__, __file__)  # type: ignore[no-any-return]

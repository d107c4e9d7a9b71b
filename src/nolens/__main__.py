"""The first lines of the `nolens` command, and `python -m nolens`."""

from nolens.interrupt import catch, ignore

catch()  # Before anything is loaded: this module is the command's alone.


def main() -> None:
    """Run the command and leave with its exit code."""
    from nolens.cli.main import main as command

    try:
        command()
    finally:
        ignore()  # What Python puts away now takes a while; the exit code stands.


if __name__ == "__main__":
    main()

"""`python -m nolens`."""

from nolens.cli.main import main

main()

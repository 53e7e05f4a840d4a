"""`python -m astray` is the `astray` command."""

from astray.cli import main

main()

"""`python -m naraha.diagrams` is the command `naraha`."""

from .cli import main

main()

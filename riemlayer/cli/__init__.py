"""The command line `riemlayer`; also `python -m riemlayer`."""

from riemlayer.cli.app import main

__all__ = ["main"]

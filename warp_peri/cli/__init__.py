"""The command warp-peri; Ctrl-C while it is still being imported is quiet, too."""

import os
import signal
import sys
from importlib import import_module
from types import FrameType


def start() -> int:
    """Run `warp-peri`; see warp_peri.cli.main."""
    # An interrupt inside the import of a compiled module may come out as any error: leave at once.
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:  # not where the shell has it ignored
        signal.signal(signal.SIGINT, _leave)
    run = import_module(f"{__name__}.main").main  # imports all that takes time
    if usual is signal.default_int_handler:
        signal.signal(signal.SIGINT, usual)
    try:
        return int(run())
    except KeyboardInterrupt:
        _say()
        return 130


def _leave(number: int, frame: FrameType | None) -> None:
    _say()
    os._exit(130)


def _say() -> None:
    print("interrupted; nothing is kept yet", file=sys.stderr, flush=True)

"""The command warp-peri."""

import signal
from importlib import import_module


def start() -> int:
    """Run `warp-peri` (warp_peri.cli.main); Ctrl-C inside its import ends the process at once."""
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:  # not where the shell has it ignored
        # An interrupt inside the import of a compiled module may come out as any error.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    run = import_module(f"{__name__}.main").main  # imports all that takes time
    signal.signal(signal.SIGINT, usual)
    return int(run())

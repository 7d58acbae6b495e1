"""Where the command begins: Ctrl-C while it is still being imported ends it quietly, too."""

from __future__ import annotations

import sys


def main() -> int:
    """Run `warp-peri`; see warp_peri.cli.main."""
    try:
        from warp_peri.cli.main import main as run  # all that takes time to import

        return run()
    except KeyboardInterrupt:
        print("interrupted; what is finished is kept", file=sys.stderr)
        return 130

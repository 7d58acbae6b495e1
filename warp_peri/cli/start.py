"""Where the command begins: Ctrl-C while it is still being imported ends it quietly, too."""

from __future__ import annotations

from warp_peri.errors import exit_status


def main() -> int:
    """Run `warp-peri`; see warp_peri.cli.main."""

    def run() -> int:
        from warp_peri.cli.main import main as command

        return command()

    return exit_status(run)

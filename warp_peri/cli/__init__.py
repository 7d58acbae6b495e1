"""The command warp-peri; `main` is loaded when it runs."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.cli import main as main
else:
    __getattr__, __dir__, _ = lazy(__name__)

"""One regression over rows of a basis; materials bring their parametrisation and nothing else."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.fitting import diagnose as diagnose
else:
    __getattr__, __dir__, _ = lazy(__name__)

"""The regression over rows of a basis that all materials are fitted by."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.fitting import diagnose as diagnose
else:
    __getattr__, __dir__, _ = lazy(__name__)

"""Building blocks of every material; torch is loaded with `torch_bridge` on demand."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.core import torch_bridge as torch_bridge
else:
    __getattr__, __dir__, _ = lazy(__name__)

"""Materials, and the fit that carries one to another lattice, which is loaded when it is needed."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.materials import transfer as transfer
else:
    __getattr__, __dir__, _ = lazy(__name__)

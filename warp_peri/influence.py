"""Influence functions of users: `warp_peri.influence`."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.materials.influence import InfluenceFunction as InfluenceFunction
    from warp_peri.materials.influence import conical as conical
    from warp_peri.materials.influence import exponential as exponential
    from warp_peri.materials.influence import gaussian as gaussian
    from warp_peri.materials.influence import named as named
    from warp_peri.materials.influence import table as table
else:
    __getattr__, __dir__, __all__ = lazy(__name__)

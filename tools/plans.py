"""Which loads run with which seeds at a finite temperature."""

from collections.abc import Sequence
from dataclasses import dataclass

from tools.loads import TEST, TRAINING, VALIDATION, Load
from tools.make_graphene import graphene_bodies
from tools.samples import Piece
from tools.thermal import Task


@dataclass(frozen=True)
class Plan:
    """Runs of one body.

    A load runs with one of the seeds 1 … `seeds`, in turn. Unloaded runs exist for these and for
    `spare` more seeds, whose noise no loaded run shares. Every `repeat`-th load runs a second time
    with the next seed: the difference is the noise of the shared-seed reduction.

    Attributes:
        body: what runs.
        groups: loads by set name.
        seeds, spare: numbers of seeds; two at least, one at least.
        repeat: how far apart the repeated loads are.
    """

    body: Piece
    groups: dict[str, Sequence[Load]]
    seeds: int
    spare: int
    repeat: int

    def seed(self, number: int) -> int:
        """Seed of the load of this number in its group."""
        return 1 + number % self.seeds

    def repeated(self, group: str) -> dict[int, int]:
        """Second seeds by the numbers of the loads that run again."""
        return {
            number: self.seed(number + 1)
            for number in range(0, len(self.groups[group]), self.repeat)
        }

    def unloaded(self, seed: int) -> Task:
        """The run without load."""
        return Task(self.body, None, 0.0, seed)

    def every_seed(self) -> range:
        """Seeds of the unloaded runs."""
        return range(1, self.seeds + self.spare + 1)

    def spare_seeds(self) -> range:
        """Seeds of unloaded runs only."""
        return range(self.seeds + 1, self.seeds + self.spare + 1)

    def tasks(self, factors: Sequence[float]) -> list[Task]:
        """Every run, for every factor on the loads."""
        tasks = [self.unloaded(seed) for seed in self.every_seed()]
        for factor in factors:
            for group, loads in self.groups.items():
                for number, load in enumerate(loads):
                    tasks.append(Task(self.body, load, factor, self.seed(number)))
                for number, seed in self.repeated(group).items():
                    tasks.append(Task(self.body, loads[number], factor, seed))
        return tasks


def graphene_plans() -> list[Plan]:
    """The sheet with training and validation loads, and the disk."""
    sheet, disk = graphene_bodies()
    return [
        # The disk first: its runs are the longest.
        Plan(disk, {"test": TEST}, seeds=4, spare=4, repeat=4),
        Plan(sheet, {"train": TRAINING, "val": VALIDATION}, seeds=20, spare=8, repeat=9),
    ]

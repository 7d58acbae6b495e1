"""Damaged and hostile files: a clear error or a correct read; no crash, hang or hunger."""

import json
import select
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.mutations import mutate

ROOT = Path(__file__).parent.parent.parent
SECONDS, MEMORY = 5.0, 1e9


class Reader:
    """A process that reads files, started again when it dies."""

    def __init__(self):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.read_files"], cwd=ROOT, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        assert json.loads(self.process.stdout.readline()) == {"ready": True}

    def read(self, path):
        """What the process says of a file; None when it dies or takes too long."""
        self.process.stdin.write(f"{path}\n")
        self.process.stdin.flush()
        if not select.select([self.process.stdout], [], [], SECONDS)[0]:
            return None
        line = self.process.stdout.readline()
        return json.loads(line) if line else None

    def close(self):
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()


def read_all(folder, number, seed):
    """Failures, and how many of the files were read and refused."""
    failures, read, refused, reader = [], 0, 0, Reader()
    try:
        for path, what, right in mutate(folder, number, seed):
            said = reader.read(path)
            if said is None:
                failures.append((path.name, what, f"died or hung ({reader.process.poll()})"))
                reader.close()
                reader = Reader()
            elif "crashed" in said or said["memory"] > MEMORY:
                failures.append((path.name, what, said))
            elif "read" in said:
                read += 1
                if right is not None and said["read"] != right:
                    failures.append((path.name, what, "read as something else"))
            else:
                refused += 1
                words = said["refused"]
                if path.name not in words or len(words) > 2100 or not words.isprintable():
                    failures.append((path.name, what, words))
    finally:
        reader.close()
    return failures, read, refused


@pytest.mark.parametrize("number", [60])
def test_every_mutated_file_is_refused_clearly_or_read_right(tmp_path, number):
    failures, read, refused = read_all(tmp_path, number, seed=number)
    assert failures == []
    assert read + refused == number
    assert refused > number / 2
    assert read > 0

"""Reads the files named on stdin, one a line, and says on stdout what came of each, as JSON."""

import json
import re
import sys
import time

from warp_peri import InputError
from warp_peri.materials.lps import Model
from warp_peri.points.dataset import content_hash, load_dataset


def peak():
    """Most bytes of memory this process has had; that of rusage would start with its parent's."""
    with open("/proc/self/status", encoding="ascii") as file:
        return 1024 * int(re.search(r"VmHWM:\s+(\d+)", file.read())[1])


def main():
    print(json.dumps({"ready": True}), flush=True)
    for line in sys.stdin:
        path = line.rstrip("\n")
        begin = time.perf_counter()
        said = {"path": path}
        try:
            if path.endswith(".h5"):
                said["read"] = content_hash(load_dataset(path))
            else:
                Model.load(path)
                with open(path, encoding="utf-8") as file:
                    said["read"] = json.dumps(json.load(file), sort_keys=True)
        except InputError as error:
            said["refused"] = str(error)
        except BaseException as error:
            said["crashed"] = f"{type(error).__name__}: {error}"[:500]
        said["seconds"] = time.perf_counter() - begin
        said["memory"] = peak()
        print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main()

"""Reads the files named on stdin, one a line, and says on stdout what came of each, as JSON."""

import json
import resource
import sys
import time

from warp_peri import InputError, load_dataset, load_model
from warp_peri.dataset import content_hash


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
                load_model(path)
                with open(path, encoding="utf-8") as file:
                    said["read"] = json.dumps(json.load(file), sort_keys=True)
        except InputError as error:
            said["refused"] = str(error)
        except BaseException as error:
            said["crashed"] = f"{type(error).__name__}: {error}"[:500]
        said["seconds"] = time.perf_counter() - begin
        said["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main()

"""python -m warp_peri is the command warp-peri."""

from warp_peri.cli import start

if __name__ == "__main__":
    raise SystemExit(start())

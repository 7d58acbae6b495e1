"""python -m warp_peri is the command warp-peri."""

from warp_peri.cli.start import main

if __name__ == "__main__":
    raise SystemExit(main())

"""``python -m advdiff_sumo`` is the command ``advdiff-sumo``."""

from advdiff_sumo.cli.main import main

if __name__ == "__main__":
    main()

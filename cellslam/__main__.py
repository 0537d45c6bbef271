"""The command line, as `python -m cellslam`."""

from cellslam.benchmarks.cli.main import main

raise SystemExit(main())

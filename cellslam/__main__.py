"""The command line, as `python -m cellslam`."""

from cellslam.cli.main import main

raise SystemExit(main())

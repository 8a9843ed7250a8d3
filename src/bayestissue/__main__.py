"""``python -m bayestissue`` is the same as ``bayestissue``."""

from bayestissue.cli import main

main()

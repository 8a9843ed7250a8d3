"""The command ``bayestissue``, also ``python -m bayestissue``: it can be stopped from its first moment on."""

from __future__ import annotations

from bayestissue import stopping


def main() -> None:
    """Run the command line so that Ctrl-C and a polite kill end it at once."""
    stopping.on_request()
    from bayestissue.cli import main as command_line

    try:
        command_line()
    finally:
        stopping.done()


if __name__ == "__main__":
    main()

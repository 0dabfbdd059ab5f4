"""``python -m synthgen`` is the ``synthgen`` command."""

from synthgen.cli.main import run

if __name__ == "__main__":
    run()

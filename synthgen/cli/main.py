"""The ``synthgen`` command: puts the verbs together and turns errors into exit codes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from synthgen import __version__
from synthgen.cli import (
    bench,
    config,
    doctor,
    fit,
    generate,
    models,
    plan,
    preview,
    show,
    train_init,
    verify,
)
from synthgen.cli.output import DONE, WORK_LEFT, WRONG, Result, stdout_kept_clean
from synthgen.errors import SynthgenError, WorkLeft

# The base of every complaint about the command line itself.
_UsageError: Any = typer.BadParameter.__mro__[1]
_INTERRUPTED = 130

app = typer.Typer(
    name="synthgen",
    help="Synthetic hands with labels that are checked.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("doctor")(doctor.doctor)
app.add_typer(models.app, name="models")
app.add_typer(config.app, name="config")
app.command("plan")(plan.plan)
app.command("generate")(generate.generate)
app.command("show")(show.show)
app.command("verify")(verify.verify)
app.command("fit")(fit.fit)
app.command("train-init")(train_init.train_init)
app.command("preview")(preview.preview)
app.command("bench")(bench.bench)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"synthgen {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Version.")
    ] = False,
) -> None:
    """Synthetic hands with labels that are checked."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str or None
        Without the program's name; None takes the process's own.

    Returns
    -------
    int
        Exit code: 0 done, 1 a check failed, 2 wrong use or bad input, 3 interrupted with work
        left (the same command resumes).
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in words
    try:
        with stdout_kept_clean(as_json):
            result = app(args=words, prog_name="synthgen", standalone_mode=False)
        return _finish(result, as_json)
    except KeyboardInterrupt:
        return _finish(_INTERRUPTED, as_json)
    except _UsageError as error:
        return _refuse(_usage(error), as_json, WRONG)
    except SynthgenError as error:
        return _refuse(str(error), as_json, WORK_LEFT if isinstance(error, WorkLeft) else WRONG)
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        sys.stdout = None
        return DONE
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _refuse(f"{place}{error.strerror or error}", as_json, WRONG)


def run() -> None:
    """Entry point of the installed command."""
    sys.exit(main())


def _finish(result: object, as_json: bool) -> int:
    if isinstance(result, Result):
        return result.emit(as_json)
    if result == _INTERRUPTED:
        return _refuse("interrupted; run the same command again", as_json, WORK_LEFT)
    return int(result) if isinstance(result, int) else DONE


def _refuse(message: str, as_json: bool, code: int) -> int:
    if as_json:
        return Result({"error": message}, code=code).emit(True)
    typer.echo(f"synthgen: {message}", err=True)
    return code


def _usage(error: Any) -> str:
    message = str(error.format_message()) or "A verb is missing."
    command = error.ctx.command_path if error.ctx is not None else "synthgen"
    return f"{message} Try '{command} --help'."

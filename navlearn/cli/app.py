"""The application: its commands, and how it tells what went wrong.

Commands import what they need when they run, so that ``navlearn --help`` answers at once.
"""

import os
import warnings
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import navlearn
from navlearn.cli.allan import allan
from navlearn.cli.check import check
from navlearn.cli.evaluate import evaluate
from navlearn.cli.export import export
from navlearn.cli.methods import methods
from navlearn.cli.predict import predict
from navlearn.cli.run import run
from navlearn.cli.simulate import simulate
from navlearn.cli.train import train
from navlearn.cli.tune import tune
from navlearn.errors import NavlearnError

REFUSED = 2
"""Exit code where an input is refused; 1 is for findings of ``check`` and drives of a sweep that
failed."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""

GOES_ON = ("run", "tune", "evaluate")
"""Commands that keep what they have finished."""


class _CommandGroup(TyperGroup):
    """Turns errors that navlearn raises on purpose into one message and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was asked for."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise
        except KeyboardInterrupt:
            rest = ": the same command goes on where it stopped"
            said = rest if ctx.invoked_subcommand in GOES_ON else ""
            typer.echo(f"\nnavlearn: interrupted{said}", err=True)
            raise typer.Exit(INTERRUPTED) from None
        except (NavlearnError, OSError) as problem:
            if ctx.params.get("debug"):
                raise
            typer.echo(f"navlearn: {problem}", err=True)
            raise typer.Exit(REFUSED) from None


app = typer.Typer(
    name="navlearn",
    cls=_CommandGroup,
    help="Learning-augmented land-vehicle navigation: check a drive, put GNSS outages into it, "
    "and see what a learned error model does.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"navlearn {navlearn.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
    version: Annotated[
        bool,
        typer.Option("--version", help="Show the version.", callback=_version, is_eager=True),
    ] = False,
) -> None:
    """Take the options that stand before the command."""


for _command in (check, allan, simulate, methods, run, train, tune, evaluate, export, predict):
    app.command()(_command)


def show_once() -> Callable[..., None]:
    """Return a way to show warnings that says each one once, without the code that gave it."""
    shown: set[str] = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        text = str(message)
        if text not in shown:
            shown.add(text)
            typer.echo(f"navlearn: warning: {text}", err=True)

    return show


def main() -> None:
    """Run the command line."""
    # Tensors here are small: several threads would spend more on meeting than on working.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    warnings.showwarning = show_once()
    app()

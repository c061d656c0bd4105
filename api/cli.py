"""The command line: `fluxtwin COMMAND ...`.

Every command is one module of `fluxtwin.commands`; what computes is imported inside the command, so that
`--help` is instant. Exit status: 0 done, 1 the data do not allow an answer, 2 bad input, 130 interrupted,
143 ended by SIGTERM, 70 an error of ours.
"""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated

import typer

import fluxtwin
from fluxtwin import console
from fluxtwin.calib import methods
from fluxtwin.commands.options import QuietOption, VerboseOption, as_command
from fluxtwin.console import clean, manners
from fluxtwin.sim.base import processes
from fluxtwin.sim.base.errors import FluxtwinError

OUR_FAULT = 70
_COMMANDS = (
    "run simulate ensemble campaign map info convert check calibrate apply export trend yaw attitude diagnose plan "
    "effects passes field"
)
"""The modules of `fluxtwin.commands`, in the order of the help."""

app = typer.Typer(
    name="fluxtwin",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"fluxtwin {fluxtwin.__version__}")
        raise typer.Exit


@app.callback()
def fluxtwin_command(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """The digital twin of a spacecraft's attitude and magnetometer: simulate, calibrate, find what differs."""
    manners.quiet, manners.verbose = quiet, verbose


for _name in _COMMANDS.split():
    _module = import_module(f"fluxtwin.commands.{_name}")
    app.command(_name, short_help=_module.BRIEF)(as_command(_module.command, methods.offered()))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status; a user's mistake costs one message, no traceback."""
    # Our matrices are small or tall and thin: BLAS threads only wait for each other, and the bits would depend on them.
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    if arguments is None:
        processes.start_and_end_quickly()
    _be_plain()
    if arguments is None:
        console.heed_no_reader()
    try:
        processes.stop_if_asked()
        given = None if arguments is None else list(arguments)
        console.GIVEN[:] = sys.argv[1:] if given is None else given
        outcome = app(given, prog_name="fluxtwin", standalone_mode=False)
        if outcome == 130:  # newer typer turns the interrupt into this status by itself
            raise KeyboardInterrupt
        processes.stop_if_asked()
        status = outcome if isinstance(outcome, int) else 0
        try:
            sys.stdout.flush()
        except BrokenPipeError:
            return _reader_has_gone(status)
        return status
    except FluxtwinError as error:
        return _fail(_in_words(error), error.exit_status)
    except (KeyboardInterrupt, typer.Abort):
        return _fail(processes.ENDING, processes.stopped_status())
    except (BrokenPipeError, SystemExit):  # typer turns the former into the latter
        return _reader_has_gone()
    except MemoryError:
        return _fail("not enough memory for this; use fewer samples or a coarser step", 2)
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        return _fail(f"{name}{error.strerror or error}", 2)
    except Exception as error:
        if hasattr(error, "exit_code") and hasattr(error, "show"):  # a usage error, click's own or typer's copy
            error.show()
            return int(error.exit_code)
        if os.environ.get("FLUXTWIN_DEBUG"):
            traceback.print_exc()
            return OUR_FAULT
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{os.path.basename(last.filename)}:{last.lineno}"
        return _fail(
            f"internal error, not your fault: {type(error).__name__}: {error} ({place})."
            " FLUXTWIN_DEBUG=1 shows where; please report it",
            OUR_FAULT,
        )
    finally:
        manners.quiet = manners.verbose = False  # -q and -v are for one call


def _be_plain() -> None:
    """Warnings as one line; characters the terminal cannot show are replaced, never fatal; a closed stream is silent."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    warnings.formatwarning = lambda message, *_, **__: "" if manners.quiet else f"note: {clean(str(message))}\n"
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")


def _reader_has_gone(status: int = 0) -> int:
    """Somebody read as much as they wanted, as `| head` does: no error, and no complaint at the exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return status


def _in_words(error: FluxtwinError) -> str:
    details = getattr(error, "details", None)
    if not details:
        return str(error)
    return f"{error}\n{details}" if manners.verbose else f"{error} (-v lists those that are known)"


def _fail(message: str, status: int) -> int:
    print(f"fluxtwin: {clean(message)}", file=sys.stderr)
    return status

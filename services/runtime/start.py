"""How a service's process starts and ends: settings file, one line for what the user must correct, exit status."""

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from vemlight.errors import FatalError, UserError
from vemlight.runtime.open_files import raise_file_limit
from vemlight.settings_file import read_settings


def start(main: Callable[..., None], arguments: Sequence[str]) -> int:
    """Runs a service with the settings file in `arguments`, if there is one; returns its status.

    main: takes the settings, how often the service was restarted, and what follows the settings' file in `arguments`.
    """

    def work() -> None:
        main(read_settings(Path(arguments[0]) if arguments else None), int(os.environ.get("VEMLIGHT_RESTARTS", "0")), *arguments[1:])

    return status_of(work)


def status_of(work: Callable[[], None]) -> int:
    """Does the work of a process, with as many open files as it may have.

    Returns 0 when it was stopped or is done, 2 for what the user must correct (one line on stderr), 1 for our own fault.
    """
    raise_file_limit()
    try:
        work()
    except UserError as error:
        print(f"vemlight: {error}", file=sys.stderr)
        return 2
    except FatalError as error:
        print(f"vemlight: {error}", file=sys.stderr)
        return 1
    except Exception:
        traceback.print_exc()
        return 1
    return 0

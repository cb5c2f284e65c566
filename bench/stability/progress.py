"""What is left of a bench run that was cut off, and where its table stands."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

from vemlight.files import written_whole

PAGE = Path(__file__).parents[2] / "docs" / "stability.md"


class Unfinished:
    """The parts of a run that are done, in a file beside its CSV until all are: the same run, begun again, goes on with the others."""

    def __init__(self, path: Path, run: object) -> None:
        """run: what was asked for, as JSON can hold it. A file of another run counts for nothing."""
        self._path, self._run = path, json.loads(json.dumps(run))
        before = json.loads(path.read_text()) if path.exists() else {}
        self.done: list[list[str]] = before["done"] if before.get("run") == self._run else []

    def left(self, parts: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
        """Those of the parts that are to be done; says so when some are not."""
        if self.done:
            print(f"{len(self.done)} of {len(parts)} were done before this run was cut off; delete {self._path} to begin anew", flush=True)
        return [part for part in parts if [*part] not in self.done]

    def add(self, part: tuple[str, str]) -> None:
        """One more is done, and its rows are written."""
        self.done.append([*part])
        with written_whole(self._path) as new:
            new.write_text(json.dumps({"run": self._run, "done": self.done}))

    def finish(self) -> None:
        """All are done."""
        self._path.unlink(missing_ok=True)


def show_table(name: str, text: str) -> None:
    """Puts a Markdown table into docs/stability.md, between <!-- NAME --> and <!-- end -->."""
    place = re.compile(rf"(<!-- {name} -->\n).*?(?=<!-- end -->)", re.DOTALL)
    page, found = place.subn(lambda match: f"{match[1]}{text}\n", PAGE.read_text())
    assert found == 1, f"{PAGE}: no place for the table {name}"
    with written_whole(PAGE) as new:
        new.write_text(page)

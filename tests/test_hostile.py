"""The trial of hostile files finds what a reader may not do."""

import subprocess
import sys
from pathlib import Path

PROGRAM = '''
import os, sys, time
from pathlib import Path
from tests.support.hostile import trial
from tests.support.hostile.format import Format
from vemlight.errors import UserError
from vemlight.files import notice

trial.MAX_S, trial.MAX_WAIT_S, trial.MAX_BYTES = 1.0, 3.0, 400 * 2**20

def whole(folder):
    (folder / "a.txt").write_text("sound")
    return [folder / "a.txt"]

def read(path):
    match path.read_text():
        case "refused":
            raise UserError(f"{path}: is no good; mend it")
        case "notice":
            notice("as it should be")
        case "raises":
            raise KeyError("x")
        case "ends":
            os._exit(3)
        case "crashes":
            os.abort()
        case "computes":
            while True:
                pass
        case "waits":
            time.sleep(100)
        case "speaks":
            print("libfoo: bad thing")
        case "grows":
            return b"x" * (400 * 2**20)

bombs = ["refused", "notice", "raises", "ends", "crashes", "computes", "waits", "speaks", "grows"]
trial.FORMATS["test"] = Format(".txt", whole, read, lambda: {name: name.encode() for name in bombs})
bombs, faults = trial.examine("test", 0, 0, Path(sys.argv[1]))
print(bombs)
for fault in faults:
    print(fault.name.split(" (")[0], fault.reason, sep=": ")
'''


def test_each_kind_of_fault_is_found_and_its_file_is_kept(tmp_path):
    command = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    run = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, check=True)
    count, *found = run.stdout.splitlines()
    assert int(count) == 9
    assert found[:-1] == [
        "bomb raises: KeyError: 'x' at <string>:22",
        "bomb ends: the child ended",
        "bomb crashes: killed by SIGABRT",
        "bomb computes: more than 1 s",
        "bomb waits: waits for more than 3 s",
        "bomb speaks: a library said b'libfoo: bad thing'",
    ]
    assert found[-1].startswith("bomb grows: ")
    assert found[-1].endswith(" MB")
    assert len(list(tmp_path.iterdir())) == 7

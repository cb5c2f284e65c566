"""What is dropped on the page: limited, stored under names of our own, decoded in a child, never where its sender says."""

import asyncio
import contextlib
import json
import os
import socket
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.support.viewer_process import ViewerProcess
from vemlight.errors import UserError
from vemlight.light.images import write_exr
from vemlight.runtime.session import INCOMING, READY, SESSION, make_session, upload_folder
from vemlight.viewer import upload_handlers, uploads
from vemlight.viewer.upload_handlers import UploadHandlers
from vemlight.viewer.uploads import MAX_FILES, MAX_UPLOADS, Announcement, NamedFile, Uploads

HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + 8 * b"\x80\x80\x80\x81"


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "session"
    make_session(folder)
    monkeypatch.setenv(SESSION, str(folder))
    return folder


def announced(*files: tuple[str, int], kind: str = "light", label: str = "sky") -> Announcement:
    return Announcement(kind=kind, label=label, files=tuple(NamedFile(name, size) for name, size in files))  # type: ignore[arg-type]


async def blocks(content: bytes):
    for k in range(0, len(content), 1000):
        yield content[k : k + 1000]


def sent(taken: Uploads, *files: tuple[str, bytes], kind: str = "light") -> tuple[str, list[str]]:
    """The number of an upload whose files have come, and under which names they are stored."""
    number = taken.announce(announced(*((name, len(content)) for name, content in files), kind=kind))

    async def receive_all() -> None:
        for k, (_, content) in enumerate(files):
            await taken.receive(number, k, blocks(content))

    asyncio.run(receive_all())
    return number, sorted(os.listdir(Path(os.environ[SESSION]) / INCOMING / number))


def left_over(session: Path) -> list[str]:
    return [str(path.relative_to(session)) for path in session.rglob("*") if path.parent != session]


NAMES = [
    ("../../../home/sky.hdr", "sky.hdr"), ("/etc/passwd", "passwd.hdr"), ("..", "file_000000.hdr"), ("a\x00b.hdr", "file_000000.hdr"),
    ("sky\n.exr", "file_000000.hdr"), (".hidden", "file_000000.hdr"), ("lens.toml", "lens.hdr"), ("b" * 255, "file_000000.hdr"),
    ("C:\\sky.hdr", "file_000000.hdr"), ("sky.py", "sky.hdr"), ("\u202egpj.hdr", "file_000000.hdr"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "stored"), NAMES)
def test_a_name_never_leads_anywhere_and_the_bytes_say_the_kind(session, name, stored):
    _, names = sent(Uploads(1), (name, HDR))
    assert names == [stored]
    assert {path.parent.parent.name for path in session.rglob("*.hdr")} == {INCOMING}


def test_names_that_would_fall_together_are_numbers(session):
    _, names = sent(Uploads(1), ("a.hdr", HDR), ("a.exr", HDR), ("b.hdr", HDR))
    assert names == ["b.hdr", "file_000000.hdr", "file_000001.hdr"]


def test_a_name_like_our_own_is_a_number_too(session):
    _, names = sent(Uploads(1), ("file_000001.hdr", HDR), ("\u00e4.hdr", HDR))
    assert names == ["file_000000.hdr", "file_000001.hdr"]


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("sky.hdr", b"", "is no file of a known kind"), ("sky.hdr", b"\x7fELF" + bytes(99), "is a program"),
        ("sky.hdr", b"PK\x03\x04" + bytes(99), "is a ZIP archive"), ("sky.exr", b"words", "is no file of a known kind"),
        ("sky.exr", b"<html>", "is a web page"),
        ("sky.exr", b"glTF" + bytes(99), "is a glTF scene"), ("sky.exr", bytes(99), "is a binary file"),
    ],
)  # fmt: skip
def test_other_kinds_are_refused_and_nothing_is_left(session, name, content, line):
    taken = Uploads(1)
    with pytest.raises(UserError, match=line):
        sent(taken, (name, content))
    assert left_over(session) == []
    assert taken.summary()["used_bytes"] == 0


def test_more_bytes_than_announced_are_refused_and_fewer_too(session):
    taken = Uploads(1)
    for size in (len(HDR) - 1, len(HDR) + 1):
        number = taken.announce(announced(("sky.hdr", size)))
        with pytest.raises(UserError, match="bytes came"):
            asyncio.run(taken.receive(number, 0, blocks(HDR)))
    assert left_over(session) == []


def test_the_cap_counts_what_is_announced_and_is_given_back(session):
    taken = Uploads(2)
    number = taken.announce(announced(("a.hdr", 1_500_000)))
    with pytest.raises(UserError, match="MB are too much"):
        taken.announce(announced(("b.hdr", 600_000)))
    taken.remove(number)
    taken.announce(announced(("b.hdr", 2_000_000)))
    with pytest.raises(UserError, match="MB are too much"):
        taken.announce(announced(("c.hdr", 1)))


def test_there_are_so_many_uploads_and_no_more(session, monkeypatch):
    taken = Uploads(1)
    for _ in range(MAX_UPLOADS):
        taken.announce(announced(("a.hdr", 1)))
    with pytest.raises(UserError, match="uploads already"):
        taken.announce(announced(("a.hdr", 1)))
    monkeypatch.setattr(uploads, "ABANDONED_S", -1.0)  # what does not go on gives way
    taken.announce(announced(("a.hdr", 1)))
    assert len(left_over(session)) == 1


def test_an_upload_that_is_not_there_or_not_complete_is_neither_written_nor_decoded(session):
    taken = Uploads(1)
    number = taken.announce(announced(("a.hdr", len(HDR)), ("b.hdr", len(HDR))))
    for wrong, index in (("0" * 16, 0), (number, 2), ("../" + number, 0)):
        with pytest.raises(UserError, match="no such file is expected"):
            taken.expected(wrong, index)
    asyncio.run(taken.receive(number, 0, blocks(HDR)))
    with pytest.raises(UserError, match="no such file is expected"):  # twice
        taken.expected(number, 0)
    with pytest.raises(UserError, match="no such upload is complete"):
        asyncio.run(taken.check(number))


def test_what_is_decoded_becomes_playable_by_its_number_alone(session):
    taken = Uploads(1)
    number, _ = sent(taken, ("sky.hdr", HDR))
    assert upload_folder(number) is None
    assert asyncio.run(taken.check(number)) == "one picture"
    assert upload_folder(number) == session / READY / number
    assert [row["id"] for row in taken.summary()["uploads"]] == [number]
    taken.remove(number)
    assert left_over(session) == []


def test_a_viewer_that_starts_again_deletes_what_the_one_before_it_left(session):
    before = Uploads(1)
    number, _ = sent(before, ("sky.hdr", HDR))
    asyncio.run(before.check(number))
    sent(before, ("other.hdr", HDR))
    assert len(left_over(session)) == 4  # two folders with a file each
    after = Uploads(1)
    after.remove_left_over()
    assert left_over(session) == []
    assert upload_folder(number) is None


@pytest.mark.parametrize("number", ["", "..", "../incoming", "0" * 15, "0" * 17, "A" * 16, "0" * 15 + "/", "0" * 16 + "\n", "٠" * 16])
def test_a_number_is_sixteen_digits_and_no_path(session, number):
    assert upload_folder(number) is None


def test_a_link_is_no_upload(session, tmp_path):
    (session / READY / ("0" * 16)).symlink_to(tmp_path)
    assert upload_folder("0" * 16) is None


def png_bomb() -> bytes:
    """20,000 x 20,000 pixels of black in a megabyte."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")

    side = (20_000).to_bytes(4, "big")
    packed = zlib.compressobj(9)
    rows = b"".join(packed.compress(bytes(60_001 * 100)) for _ in range(200)) + packed.flush()
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", side + side + b"\x08\x02\0\0\0") + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


BOMBS = {
    "a bomb": png_bomb, "half a picture": lambda: HDR[:-5], "a header": lambda: b"#?RADIANCE\n",
    "an EXR of nothing": lambda: b"\x76\x2f\x31\x01",
    "pixels without end": lambda: b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 999999999 +X 999999999\n\x02\x02\xff\xff",
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_what_cannot_be_decoded_is_one_line_and_is_gone(session, name):
    taken = Uploads(8)
    number, _ = sent(taken, ("sky.hdr", BOMBS[name]()))
    with pytest.raises(UserError) as error:
        asyncio.run(taken.check(number))
    assert len(str(error.value).splitlines()) == 1
    assert str(session) not in str(error.value)
    assert left_over(session) == []


def test_a_child_that_takes_too_long_is_ended(session, monkeypatch):
    monkeypatch.setattr(uploads, "CHECK_S", 0.05)
    taken = Uploads(1)
    number, _ = sent(taken, ("sky.hdr", HDR))
    with pytest.raises(UserError, match="takes over"):
        asyncio.run(taken.check(number))
    assert left_over(session) == []


def test_an_upload_that_is_removed_while_it_is_decoded_is_one_line(session):
    taken = Uploads(1)
    number, _ = sent(taken, ("sky.hdr", HDR))

    async def both() -> None:
        checking = asyncio.create_task(taken.check(number))
        await asyncio.sleep(0)
        taken.remove(number)
        await checking

    with pytest.raises(UserError):
        asyncio.run(both())
    assert left_over(session) == []
    assert taken.summary()["uploads"] == []


def test_a_sender_of_some_bytes_now_and_then_loses_its_place(monkeypatch):
    class Trickle:
        left = 100

        async def read(self, _: int) -> bytes:
            self.left -= 1
            await asyncio.sleep(0.02)
            return b"x" if self.left else b""

    class Request:
        content = Trickle()

    async def received() -> None:
        async for _ in UploadHandlers._blocks(None, Request()):  # type: ignore[arg-type]
            pass

    monkeypatch.setattr(upload_handlers, "STALLED_S", 0.2)
    with pytest.raises(TimeoutError):
        asyncio.run(received())


@pytest.fixture(scope="module")
def viewer(tmp_path_factory) -> Iterator[ViewerProcess]:
    folder = tmp_path_factory.mktemp("viewer")
    folder.chmod(0o700)
    make_session(folder / "session")
    before, os.environ[SESSION] = os.environ.get(SESSION), str(folder / "session")
    viewer = ViewerProcess(folder, more="uploads_mb = 8")
    os.environ.pop(SESSION) if before is None else os.environ.update({SESSION: before})
    viewer.first_line()
    yield viewer
    viewer.end()


def ask(viewer: ViewerProcess, method: str, path: str, body: bytes, type_: str, **headers: str) -> tuple[int, str]:
    """A request of any method, and its answer."""
    named = {"Host": f"127.0.0.1:{viewer.port}", "Content-Type": type_, "Content-Length": str(len(body)), "Connection": "close", **headers}
    with socket.create_connection(("127.0.0.1", viewer.port), timeout=30) as connection:
        head = f"{method} {path} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in named.items()) + "\r\n"
        answer = b""
        with contextlib.suppress(OSError):  # it was refused before all had gone
            connection.sendall(head.encode() + body)
        with contextlib.suppress(OSError):
            while block := connection.recv(65536):
                answer += block
    return int(answer.split()[1] or 0) if answer else 0, answer.partition(b"\r\n\r\n")[2].decode()


def announce(viewer: ViewerProcess, *files: tuple[str, int], **headers: str) -> tuple[int, str]:
    body = json.dumps({"kind": "light", "label": "sky", "files": [{"name": name, "size": size} for name, size in files]}).encode()
    return ask(viewer, "POST", "/uploads", body, "application/json", **headers)


def test_an_upload_over_http(viewer, tmp_path):
    write_exr(tmp_path / "sky.exr", np.random.default_rng(1).random((400, 800, 3)).astype(np.float32))  # more than a page's bytes
    content = (tmp_path / "sky.exr").read_bytes()
    assert len(content) > 2 * 2**20
    status, answer = announce(viewer, ("sky.exr", len(content)))
    assert status == 201
    number = json.loads(answer)["id"]
    assert ask(viewer, "PUT", f"/uploads/{number}/0", content, "application/octet-stream")[0] == 204
    status, answer = ask(viewer, "POST", f"/uploads/{number}", b"{}", "application/json")
    assert (status, json.loads(answer)) == (200, {"facts": "one picture"})
    assert [row["label"] for row in viewer.health()["uploads"]] == ["sky"]
    assert viewer.choose(source=f"upload {number}")[0] == 200
    assert ask(viewer, "DELETE", f"/uploads/{number}", b"", "application/json")[0] == 409  # it is chosen
    assert viewer.choose(source=None)[0] == 200
    assert ask(viewer, "DELETE", f"/uploads/{number}", b"", "application/json")[0] == 204
    assert viewer.health()["uploads"] == []


def test_another_page_may_not_send_anything(viewer):
    for origin in ("http://elsewhere.example", "null"):
        assert announce(viewer, ("sky.hdr", 10), Origin=origin)[0] == 403
    body = json.dumps({"kind": "light", "label": "x", "files": [{"name": "a.hdr", "size": 1}]}).encode()
    assert ask(viewer, "POST", "/uploads", body, "text/plain")[0] == 415  # what a form can send


@pytest.mark.parametrize(
    "body",
    [
        b"", b"[]", b"{}", b"{" * 5000, b'{"kind":"light","label":"x","files":[]}', b'{"kind":"program","label":"x","files":[]}',
        json.dumps({"kind": "light", "label": "x", "files": (MAX_FILES + 1) * [{"name": "a", "size": 1}]}).encode(),
        b'{"kind":"light","label":"x","files":[{"name":"a","size":-1}]}',
        b'{"kind":"light","label":"x","files":[{"name":"a","size":1e99}]}',
        b'{"kind":"light","label":"x","files":[{"name":"a","size":99999999999}]}',
    ],
)  # fmt: skip
def test_announcements_that_are_none_are_one_line(viewer, body):
    status, text = ask(viewer, "POST", "/uploads", body, "application/json")
    assert status == 400
    assert len(text.splitlines()) == 1


def test_bytes_that_nobody_announced_end_with_a_refusal_long_before_they_have_all_come(viewer):
    status, _ = ask(viewer, "PUT", "/uploads/0123456789abcdef/0", bytes(30_000_000), "application/octet-stream")
    assert status in (0, 400)  # 0: the connection was ended
    assert viewer.health()["used_bytes"] == 0

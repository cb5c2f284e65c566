import contextlib
import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import golden
from tests.support.damaged_messages import damaged_messages
from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import CHANNELS
from vemlight.runtime.wire_schema import schema


@pytest.mark.parametrize("name", golden.messages())
def test_a_message_comes_back_as_it_was(name):
    header, arrays = golden.messages()[name]
    seen_header, seen_arrays = wire.unpack(wire.pack(header, arrays))
    assert seen_header == header
    assert [a.tolist() for a in seen_arrays] == [a.tolist() for a in arrays]
    assert [a.dtype for a in seen_arrays] == [a.dtype for a in arrays]


@pytest.mark.parametrize("name", golden.refused())
def test_a_damaged_message_is_one_value_error(name):
    with pytest.raises(ValueError):
        wire.unpack(golden.refused()[name])


@pytest.mark.parametrize("kind", golden.version_1())
def test_a_message_of_version_1_is_refused_with_a_line_that_says_so(kind):
    with pytest.raises(wire.VersionError) as caught:
        wire.unpack(golden.version_1()[kind])
    assert str(caught.value) == golden.VERSION_LINE


def test_vectors_and_schema_are_current():
    stored = {path.name: path.read_text() for path in (golden.PROTO / "vectors").iterdir()}
    assert stored == {name: golden.text(content) for name, content in golden.vectors().items()}, "run `make golden`"
    assert (golden.PROTO / "wire.schema.json").read_text() == golden.text(schema()), "run `make golden`"


def test_the_readme_lists_every_kind_with_its_arrays():
    readme = (golden.PROTO / "README.md").read_text()
    assert readme == golden.readme(readme), "run `python tests/golden.py`"
    assert wire.KINDS.keys() == {channel.kind for channel in CHANNELS} | {"request"}


def test_vectors_hold_for_a_reader_that_knows_only_msgpack():
    for path in (golden.PROTO / "vectors").glob("[!r]*.json"):
        vector = json.loads(Path(path).read_text())
        topic, header, *arrays = (bytes.fromhex(part) for part in vector["parts"])
        assert msgspec.msgpack.decode(header) == vector["header"]
        assert topic.decode() == vector["header"]["kind"]
        for raw, array in zip(arrays, vector["arrays"], strict=True):
            assert np.frombuffer(raw, array["dtype"]).tolist() == array["values"]


def test_pack_refuses_arrays_of_another_shape():
    header, (radiance, *bright) = golden.messages()["map"]
    with pytest.raises(ValueError, match="shape"):
        wire.pack(header, [radiance[:1], *bright])
    with pytest.raises(ValueError, match="arrays belong"):
        wire.pack(header, [])


def test_damaged_messages_are_messages_or_a_value_error():
    """The same by the million: `python -m tests.support.damaged_messages`."""
    read = 0
    for parts in damaged_messages(count=20_000, seed=1):
        with contextlib.suppress(ValueError):
            header, arrays = wire.unpack(parts)
            assert wire.unpack(wire.pack(header, arrays))[0] == header
            read += 1
    assert 500 < read < 5000  # some damage is none, most is


@given(st.lists(st.binary(max_size=200), max_size=7))
@settings(max_examples=300)
def test_bytes_are_a_message_or_a_value_error(parts):
    try:
        header, arrays = wire.unpack(parts)
    except ValueError:
        return
    assert wire.unpack(wire.pack(header, arrays))[0] == header


@given(st.data())
@settings(max_examples=600)
def test_a_golden_message_with_damaged_bytes_is_legal_or_refused(data):
    parts = [bytearray(part) for part in wire.pack(*golden.messages()[data.draw(st.sampled_from(sorted(golden.messages())))])]
    part = parts[data.draw(st.integers(0, len(parts) - 1))]
    for _ in range(data.draw(st.integers(1, 4))):
        if part:
            part[data.draw(st.integers(0, len(part) - 1))] = data.draw(st.integers(0, 255))
    try:
        header, arrays = wire.unpack([bytes(p) for p in parts])
    except ValueError:
        return
    for array, (dtype, shape) in zip(arrays, header.layout(), strict=True):
        assert (array.dtype, array.shape) == (np.dtype(dtype), shape)
        assert array.dtype.kind != "f" or np.isfinite(array).all()


def test_age_uses_the_monotonic_clock_on_one_host_and_realtime_between_hosts():
    now = stamps.stamp(0, 0.0)
    stepped = msgspec.structs.replace(now, captured_ns=0)
    assert stamps.age_ms(stepped) < 60_000
    elsewhere = msgspec.structs.replace(now, monotonic_ns=0, boot_id="another")
    assert stamps.age_ms(elsewhere) < 60_000
    ahead = msgspec.structs.replace(now, captured_ns=2**62, boot_id="another")
    assert stamps.age_ms(ahead) == 0


def lights_message(squared_length: float) -> list[bytes]:
    """One light whose direction has that squared length."""
    header = wire.LightsMessage(stamp=stamps.stamp(0, 0.0), count=1, coverage="sphere")
    none, direction = np.empty((0, 3), np.float32), np.array([[0, 0, np.sqrt(squared_length)]], np.float32)
    return wire.pack(header, [np.zeros(1, np.int64), direction, np.ones((1, 3), np.float32), none, none])


@pytest.mark.parametrize(("squared_length", "accepted"), [(1.0006, True), (0.9994, True), (1.002, False), (0.998, False)])
def test_directions_are_unit_vectors_to_a_thousandth(squared_length, accepted):
    if accepted:
        wire.unpack(lights_message(squared_length))
    else:
        with pytest.raises(ValueError, match="not a unit vector"):
            wire.unpack(lights_message(squared_length))


@pytest.mark.parametrize("weight", [0.0, -0.5, 1.5])
def test_a_bright_cells_weight_is_a_fraction(weight):
    header = wire.MapMessage(stamp=stamps.stamp(0, 0.0), rows=1, cols=2, coverage="hemisphere", bright_samples=1)
    arrays = np.zeros((1, 2, 3), np.float32), np.zeros(1, np.int64), np.array([[0, 0, 1]], np.float32), np.array([weight], np.float32)
    with pytest.raises(ValueError, match="weight outside"):
        wire.unpack(wire.pack(header, arrays))


def test_headers_of_64_kilobytes_and_arrays_of_64_megabytes_are_the_largest():
    with pytest.raises(ValueError, match="a header has at most 65536 bytes, not 65537"):
        wire.unpack([b"map", bytes(2**16 + 1)])
    with pytest.raises(ValueError, match=r"^(?!a header has)"):
        wire.unpack([b"map", bytes(2**16)])
    for height, accepted in ((4096, True), (4097, False)):
        header = wire.ImageMessage(stamp=stamps.stamp(0, 0.0), width=4096, height=height)
        parts = [*wire.pack(wire.ImageMessage(stamp=header.stamp, width=1, height=1), [np.zeros((1, 1, 4), np.uint8)])]
        parts[1:] = [msgspec.msgpack.encode(header), bytes(4096 * height * 4)]
        if accepted:
            assert wire.unpack(parts)[1][0].shape == (4096, 4096, 4)
        else:
            with pytest.raises(ValueError, match="the limit is 67108864"):
                wire.unpack(parts)

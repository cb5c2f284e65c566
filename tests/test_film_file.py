"""Films by number: any order gives the same bits; what is cut, damaged or no film is one line."""

import itertools

import numpy as np
import pytest

from tests.support.films import Film, write_film
from vemlight.errors import UserError
from vemlight.light.colour_tags import ColourTags
from vemlight.light.film_file import FilmFile, film_stereo, film_tags

SIZE = (32, 64, 3)
LONG_GROUPS = Film(codec="libx265", pixels="yuv420p10le", options={"x265-params": "keyint=8:bframes=3:log-level=none:qp=4"})


def pictures(count):
    """Gray pictures that rise in even steps of signal."""
    return [np.full(SIZE, 0.02 + 0.9 * k / count) for k in range(count)]


def value(frame):
    return int(np.median(np.frombuffer(frame.planes[0], np.uint16)))


@pytest.fixture(scope="module")
def films(tmp_path_factory):
    folder = tmp_path_factory.mktemp("films")
    write_film(folder / "groups.mp4", pictures(30), LONG_GROUPS)
    write_film(folder / "lossless.mkv", [1000 * picture for picture in pictures(60)], Film("pq", "bt2020", "bt2020"), fps=50)
    return folder


@pytest.mark.parametrize("name", ["groups.mp4", "lossless.mkv"])
def test_any_order_gives_the_same_pictures(films, name):
    film = FilmFile(films / name)
    in_order = [value(film.frame(k)) for k in range(len(film))]
    assert all(a < b for a, b in itertools.pairwise(in_order))
    order = np.random.default_rng(4).permutation(len(film)).tolist()
    assert [value(film.frame(k)) for k in order] == [in_order[k] for k in order]
    film.close()


def test_stamps_size_rate_and_tags(films):
    film = FilmFile(films / "lossless.mkv")
    assert (len(film), film.fps, film.size) == (60, 50.0, (64, 32))
    assert film.time_s(0) == 0
    assert film.time_s(11) == pytest.approx(0.22, abs=1e-3)
    assert film_tags(film.frame(0)) == ColourTags("pq", "bt2020", "bt2020", "limited")
    assert film_stereo(film.frame(0)) is None


def test_pictures_without_stamps_are_counted(tmp_path, films):
    write_film(tmp_path / "plain.y4m", pictures(5), Film(codec="rawvideo", pixels="yuv420p"), fps=20)
    film = FilmFile(tmp_path / "plain.y4m")
    assert (len(film), film.fps) == (5, 20.0)
    assert [film.time_s(k) for k in (0, 4)] == [0, pytest.approx(0.2)]


@pytest.mark.parametrize(("metadata", "said"), [("top_bottom", "top-bottom"), ("left_right", "side-by-side")])
def test_films_for_two_eyes(tmp_path, metadata, said):
    write_film(tmp_path / "two.mkv", pictures(2), Film(), metadata={"stereo_mode": metadata})
    assert film_stereo(FilmFile(tmp_path / "two.mkv").frame(0)) == said


@pytest.mark.parametrize("name", ["groups.mp4", "lossless.mkv"])
@pytest.mark.parametrize("kept", [0.2, 0.4, 0.5])
def test_a_film_that_is_cut_off_is_refused(films, tmp_path, name, kept):
    data = (films / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(kept * len(data))])
    with pytest.raises(UserError, match=r"cut off.*copy"):
        FilmFile(tmp_path / name)


def test_what_is_no_film(tmp_path):
    (tmp_path / "text.mp4").write_text("no film at all")
    (tmp_path / "list.mkv").write_text("ffconcat version 1.0\nfile /etc/hostname\n")
    (tmp_path / "empty.mov").write_bytes(b"")
    (tmp_path / "head.mkv").write_bytes(b"\x1a\x45\xdf\xa3" + bytes(500))
    for name in ("text.mp4", "list.mkv", "empty.mov", "head.mkv", "absent.mp4"):
        with pytest.raises(UserError) as error:
            FilmFile(tmp_path / name)
        assert str(error.value).startswith(f"{tmp_path / name}: ")


def test_sound_alone_is_refused(tmp_path):
    import av

    with av.open(str(tmp_path / "sound.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        stream.layout = "mono"
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), "s16", "mono")
        frame.rate = 8000
        container.mux([*stream.encode(frame), *stream.encode(None)])
    with pytest.raises(UserError, match="holds sound only"):
        FilmFile(tmp_path / "sound.mkv")


def test_a_list_of_files_is_not_followed_whatever_it_is_called(tmp_path, films):
    """FFmpeg's playlists begin with text; even one that looked like a film would not be opened by another demuxer."""
    (tmp_path / "list.ts").write_text(f"#EXTM3U\n#EXTINF:1,\n{films / 'groups.mp4'}\n")
    with pytest.raises(UserError, match="is no video"):
        FilmFile(tmp_path / "list.ts")

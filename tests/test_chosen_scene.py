"""Which scene is chosen outlives the renderer, where there is room for it, and never ends it."""

from vemlight.renderer import chosen_scene


def test_the_choice_of_a_scene_is_kept(tmp_path):
    for number in ("0123456789abcdef", None):
        chosen_scene._keep(tmp_path / "scene", number)
        assert (tmp_path / "scene").read_text() == (number or "")
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]


def test_where_there_is_no_room_for_it_a_line_says_so(tmp_path, capsys):
    chosen_scene._keep(tmp_path / "gone" / "scene", "0123456789abcdef")
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert line.startswith(f"vemlight: renderer: {tmp_path}/gone/scene: the choice of a scene is not kept (No such file or directory): ")

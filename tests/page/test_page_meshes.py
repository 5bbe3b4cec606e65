"""Meshes of the URDF: read as they are written, placed as the URDF says, few enough, and from nowhere else."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from onboard import cli
from onboard.page import meshes
from onboard.page.follow import LogFrames
from onboard.page.meshes import meshes_of, read
from onboard.recording.reader import LogReader
from tests.page.browser import Tab, opened
from tests.page.made import URDF
from tests.page.served import ask, served

QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)])
BOX = np.array([CORNERS[[q[0], q[k], q[k + 1]]] for q in QUADS for k in (1, 2)])


def stl(triangles: np.ndarray) -> bytes:
    """By the format's own layout: 80 bytes, a count, and of each triangle 12 numbers and two bytes."""
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *one.ravel(), 0) for one in triangles)
    return b"solid of anything".ljust(80) + struct.pack("<I", len(triangles)) + rows


def text_stl(triangles: np.ndarray) -> bytes:
    facet = "facet normal 0 0 1\n outer loop\n{}\n endloop\nendfacet\n"
    parts = [facet.format("\n".join("  vertex {:e} {:e} {:e}".format(*corner) for corner in one)) for one in triangles]
    return f"solid box\n{''.join(parts)}endsolid box\n".encode()


def obj(backwards: bool = False) -> bytes:
    lines = [
        "# a box",
        "o box",
        *("v {} {} {} 1.0".format(*corner) for corner in CORNERS),
        "vn 0 0 1",
        "vt 0 0",
        "s off",
    ]
    lines += ["f " + " ".join(f"{one - 8 if backwards else one + 1}/1/1" for one in quad) for quad in QUADS]
    return "\r\n".join(lines).encode()


def sphere(rings: int) -> np.ndarray:
    turn, tilt = np.linspace(0, 2 * np.pi, 2 * rings + 1), np.linspace(0, np.pi, rings + 1)
    grid = np.stack(
        [np.outer(np.sin(tilt), f(turn)) for f in (np.cos, np.sin)] + [np.outer(np.cos(tilt), np.ones_like(turn))], -1
    )
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return np.concatenate([np.stack(three, axis=2).reshape(-1, 3, 3) for three in ((a, b, c), (a, c, d))])


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("box.stl", stl(BOX)),
        ("box.STL", text_stl(BOX)),
        ("box.obj", obj()),
        ("box.Obj", obj(backwards=True)),
    ],
)
def test_a_file_is_read_as_it_is_written(name: str, data: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    np.testing.assert_allclose(read(tmp_path / name), BOX)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.stl", b""),
        ("a.stl", b"solid nothing\nendsolid"),
        ("a.stl", stl(BOX)[:-1]),
        ("a.stl", b"vertex 1 2 3\nvertex 1 2 x\nvertex 1 2 3"),
        ("a.obj", b"v 0 0 0\nf 1 2 3"),
        ("a.obj", b"v 0 0 0\nf 1 0 1"),
        ("a.obj", b"v 0 0\nv 0 0 0\nf 1 2 1"),
        ("a.obj", b"f"),
        ("a.dae", b"<COLLADA/>"),
    ],
)
def test_what_is_no_mesh_is_left_out(name: str, data: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    (tmp_path / "b.stl").write_bytes(stl(BOX))
    with pytest.raises(ValueError):  # noqa: PT011 whatever the parts of the file say
        read(tmp_path / name)
    drawn = meshes_of(urdf(base=name, payload="b.stl"), tmp_path)
    assert (set(drawn.corners), drawn.left_out) == ({"payload"}, 1)


def urdf(origin: str = "", scale: str = "", **files: str) -> bytes:
    visuals = {
        link: f'<visual>{origin}<geometry><mesh filename="{file}"{scale}/></geometry></visual>'
        for link, file in files.items()
    }
    text = URDF.decode()
    for link, visual in visuals.items():
        text = text.replace(f'<link name="{link}"/>', f'<link name="{link}">{visual}</link>')
    return text.encode()


def test_a_mesh_is_where_the_urdf_has_it(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "box.stl").write_bytes(stl(BOX))
    rpy, xyz = rng.uniform(-1.5, 1.5, 3), rng.uniform(-2, 2, 3)
    origin = f'<origin rpy="{" ".join(map(str, rpy))}" xyz="{" ".join(map(str, xyz))}"/>'
    [corners] = meshes_of(urdf(origin, ' scale="0.001 -0.002 0.5"', base="box.stl"), tmp_path).corners.values()
    wanted = Rotation.from_euler("xyz", rpy).apply((BOX * [0.001, -0.002, 0.5]).reshape(-1, 3)) + xyz
    np.testing.assert_allclose(np.reshape(corners, (-1, 3)), wanted, atol=1e-4)


@pytest.mark.parametrize(
    ("shape", "half", "volume"),
    [
        ('<box size="0.4 0.2 1.0"/>', (0.2, 0.1, 0.5), 0.08),
        ('<cylinder radius="0.3" length="2"/>', (0.3, 0.3, 1.0), 2 * 8 * 0.09 * np.sin(np.pi / 8)),  # of 16 sides
        ('<sphere radius="0.5"/>', (0.5, 0.5, 0.5), 4 / 3 * np.pi * 0.125),
    ],
)
def test_a_body_of_the_urdf_has_its_size_and_is_closed(
    shape: str, half: tuple[float, ...], volume: float, tmp_path: Path
) -> None:
    link = f'<link name="base"><visual><origin xyz="0 0 7"/><geometry>{shape}</geometry></visual></link>'
    [numbers] = meshes_of(URDF.replace(b'<link name="base"/>', link.encode()), tmp_path).corners.values()
    corners = np.reshape(numbers, (-1, 3, 3)) - [0.0, 0.0, 7.0]
    round_off = 0.02  # of a circle that has 16 sides
    np.testing.assert_allclose(np.abs(corners).reshape(-1, 3).max(axis=0), half, rtol=round_off)
    a, b, c = corners.transpose(1, 0, 2)
    enclosed = float((a * np.cross(b, c)).sum() / 6)  # positive: they are seen from outside
    assert enclosed == pytest.approx(volume, rel=0.08 if "sphere" in shape else 1e-3)
    assert np.linalg.norm(np.cross(b - a, c - a).sum(axis=0)) < 1e-3


def test_what_is_no_shape_is_left_out(tmp_path: Path) -> None:
    for shape in ("<capsule/>", '<box size="1 2"/>', '<sphere radius="x"/>', "<cylinder/>", ""):
        link = f'<link name="base"><visual><geometry>{shape}</geometry></visual></link>'
        assert meshes_of(URDF.replace(b'<link name="base"/>', link.encode()), tmp_path) == ({}, 1), shape


def test_files_are_read_beside_the_urdf_alone(tmp_path: Path) -> None:
    beside = tmp_path / "vehicle"
    (beside / "meshes").mkdir(parents=True)
    for path in (tmp_path / "secret.stl", beside / "meshes/box.stl"):
        path.write_bytes(stl(BOX))
    (beside / "link.stl").symlink_to(tmp_path / "secret.stl")
    for name in (
        "meshes/box.stl",
        "package://arm/meshes/box.stl",
        "package://meshes/box.stl",
        "./meshes/../meshes/box.stl",
    ):
        assert set(meshes_of(urdf(base=name), beside).corners) == {"base"}, name
    for name in ("../secret.stl", str(tmp_path / "secret.stl"), "link.stl", "package://../secret.stl", "/dev/zero", ""):
        assert meshes_of(urdf(base=name), beside) == ({}, 1), name
    assert meshes_of(b"<robot", beside) == ({}, 0)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "box.stl").write_bytes(stl(BOX))
    assert meshes_of(urdf(base="box.stl"), tmp_path).left_out == 0
    monkeypatch.setattr(meshes, "MOST_BYTES", len(stl(BOX)) - 1)
    assert meshes_of(urdf(base="box.stl"), tmp_path) == ({}, 1)


def test_many_triangles_become_few_of_the_same_shape(tmp_path: Path) -> None:
    (tmp_path / "ball.stl").write_bytes(stl(0.3 * sphere(60)))
    (tmp_path / "box.stl").write_bytes(stl(BOX))
    drawn = meshes_of(urdf(base="ball.stl", payload="box.stl"), tmp_path)
    found = {k: np.reshape(v, (-1, 3, 3)) for k, v in drawn.corners.items()}
    ball = found["base"]
    assert 500 < len(ball) <= meshes.MOST_TRIANGLES
    assert np.linalg.norm(ball, axis=2) == pytest.approx(0.3, abs=0.02)
    volume = np.einsum("ij,ij->i", ball[:, 0], np.cross(ball[:, 1], ball[:, 2])).sum() / 6
    assert abs(volume) == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.05)
    np.testing.assert_allclose(found["payload"], BOX)


SPHERE = '<geometry><sphere radius="0.1"/></geometry>'


def test_of_a_link_without_a_visual_that_can_be_read_the_collision_geometry_is_drawn(tmp_path: Path) -> None:
    (tmp_path / "box.stl").write_bytes(stl(BOX))
    also = urdf(base="box.stl", payload="gone.stl").replace(
        b"</link>", f"<collision>{SPHERE}</collision></link>".encode()
    )
    drawn = meshes_of(also, tmp_path)
    assert drawn.left_out == 1
    assert len(drawn.corners["base"]) == 9 * len(BOX)
    assert max(drawn.corners["payload"]) == pytest.approx(0.1, rel=0.02)
    drawn = meshes_of(also, None)
    assert drawn.left_out == 2
    assert drawn.corners["base"] == drawn.corners["payload"]


def test_the_server_has_those_of_the_file_that_is_given_or_of_the_log_without_its_files(
    made_log: Path, tmp_path: Path
) -> None:
    (tmp_path / "box.stl").write_bytes(stl(BOX))
    (tmp_path / "made.urdf").write_bytes(urdf(base="box.stl"))
    source = LogFrames(LogReader(made_log))
    assert source.urdf == URDF

    def meshes(given: str = "") -> dict[str, Any]:
        with served(source, urdf=tmp_path / given if given else None) as one:
            assert json.loads(ask(one.port, "/flight").body)["meshes"] is True
            ask(one.port, "/meshes")
            found: dict[str, Any] = json.loads(ask(one.port, "/meshes").body)
            return found

    assert len(meshes("made.urdf")["corners"]["base"]) == 9 * len(BOX)
    source.urdf = urdf(base="box.stl").replace(
        b'<link name="payload"/>', f'<link name="payload"><visual>{SPHERE}</visual></link>'.encode()
    )
    for given in ("", "gone.urdf"):
        assert (set(meshes(given)["corners"]), meshes(given)["left_out"]) == ({"payload"}, 1)
    source.urdf = b""
    with served(source) as one:
        assert ask(one.port, "/meshes").status == 404
        assert json.loads(ask(one.port, "/flight").body)["meshes"] is False


def test_a_urdf_that_is_not_there_is_refused(made_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["watch", str(made_log), "--page", "--page-meshes", "nowhere.urdf"]) == cli.BAD_INPUT
    assert "--page-meshes nowhere.urdf: there is no such file" in capsys.readouterr().err


@pytest.mark.realtime
@pytest.mark.parametrize(("width", "height", "scheme"), [(1280, 800, "light"), (390, 844, "dark")])
def test_in_a_browser_they_move_with_their_links(
    tab: Tab, made_log: Path, tmp_path: Path, width: int, height: int, scheme: str
) -> None:
    (tmp_path / "ball.stl").write_bytes(stl(0.25 * sphere(150)))
    (tmp_path / "box.obj").write_bytes(obj())
    scaled = urdf('<origin xyz="-0.15 -0.1 -0.3"/>', ' scale="0.3 0.1 0.1"', base="box.obj")
    text = scaled.replace(
        b'<link name="payload"/>',
        b'<link name="payload"><visual><geometry><mesh filename="ball.stl"/></geometry></visual></link>',
    )
    (tmp_path / "made.urdf").write_bytes(text)
    tab.screen(width, height, scheme)
    with opened(tab, LogFrames(LogReader(made_log)), urdf=tmp_path / "made.urdf"):
        tab.wait("document.getElementById('arm').dataset.triangles > 500")
        canvas = "document.querySelector('#arm canvas')"
        ink = f"""(() => {{ const c = {canvas}, d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
            let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n / (d.length / 4); }})()"""
        filled = tab.run(ink)
        tab.run(f"{canvas}.scrollIntoView({{block: 'center'}})")
        tab.shot(tmp_path / f"meshes_{width}_{scheme}.png")
    log = LogFrames(LogReader(made_log))
    with opened(tab, log):
        tab.wait("document.getElementById('arm').dataset.triangles === '0'")
        assert tab.run(ink) < 0.3 * filled
    log.urdf = text.replace(b'<link name="base">', f'<link name="base"><visual>{SPHERE}</visual>'.encode())
    with opened(tab, log):
        tab.wait("document.getElementById('arm').dataset.triangles > 50")
        assert "2 shapes of the URDF are not drawn" in tab.text("#arm p")
    with Image.open(tmp_path / f"meshes_{width}_{scheme}.png") as shot:
        assert shot.size == (width, height)

"""Path files: every way to write one gives the same path, and each faulty line is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cadsculpt.errors import InputError, SceneError
from cadsculpt.formats.paths import path_csv
from cadsculpt.motion.path import ToolPath
from cadsculpt.motion.pose import rotation_matrix


def faults(text: str) -> list[str]:
    with pytest.raises(SceneError) as caught:
        path_csv.parse(text, "press.csv")
    return caught.value.faults


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_what_is_written_reads_back(seed: int, turned: bool) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    rotation = Rotation.random(n, rng=rng).as_matrix() if turned else np.tile(np.eye(3), (n, 1, 1))
    path = ToolPath(np.cumsum(rng.uniform(1e-6, 10, n)), rng.normal(size=(n, 3)) * 1e3, rotation)
    back = path_csv.parse(path_csv.text_of(path), "press.csv")
    np.testing.assert_array_equal(back.t, path.t)
    np.testing.assert_array_equal(back.at, path.at)
    np.testing.assert_allclose(back.rotation, path.rotation, atol=1e-15)
    assert turned == ("qw" in path_csv.text_of(path))


@pytest.mark.parametrize("mark", [",", ";", "\t", " ", "  ,  "])
@pytest.mark.parametrize("header", ["", "t,x,y,z", "T,X,Y,Z"])
def test_separators_headers_comments_and_blank_lines(mark: str, header: str) -> None:
    lines = ["# pressed", "", header, "0,0,0,20  # above", "", "0.5,1,2,3", "  1,1,-2,-4e0"]
    text = "\r\n".join(line.replace(",", mark) for line in lines)
    path = path_csv.parse(text.replace("\r\n", "\n"), "press.csv")
    np.testing.assert_array_equal(path.t, [0, 0.5, 1])
    np.testing.assert_array_equal(path.at, [[0, 0, 20], [1, 2, 3], [1, -2, -4]])
    np.testing.assert_array_equal(path.rotation, np.tile(np.eye(3), (3, 1, 1)))


def test_columns_stand_where_the_header_says() -> None:
    path = path_csv.parse("z,deg,t,y,x,ax,ay,az\n3,90,0,2,1,0,0,2\n", "press.csv")
    np.testing.assert_array_equal(path.at, [[1, 2, 3]])
    np.testing.assert_array_equal(path.rotation[0], rotation_matrix(np.array([0.0, 0, 1]), 90))


def test_the_three_orientations_agree() -> None:
    turn = Rotation.from_rotvec([0, np.radians(30), 0])
    qx, qy, qz, qw = turn.as_quat()
    i, j, k = turn.apply([0, 0, 1])
    by_turn = path_csv.parse("0,0,0,0,0,1,0,30", "a.csv")
    by_axis = path_csv.parse(f"0,0,0,0,{i:.17g},{j:.17g},{k:.17g}", "a.csv")
    by_quaternion = path_csv.parse(f"t,x,y,z,qw,qx,qy,qz\n0,0,0,0,{qw:.17g},{qx:.17g},{qy:.17g},{qz:.17g}", "a.csv")
    for path in (by_turn, by_axis, by_quaternion):
        np.testing.assert_allclose(path.rotation[0], turn.as_matrix(), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("0,0,0,1\n1,0,0,0\n0.5,0,0,0\n2,0,0,0\n", 3, "t goes back in time: 0.5 after 1.0"),
        ("0,0,0,1\n0,0,0,0\n", 2, "t does not move on in time"),
        ("t,x,y,z\n0,0,nan,1\n", 2, "nan is not a finite number"),
        ("# a\n\n0,0,inf,1\n", 3, "inf is not a finite number"),
        ("0,0,0,1\n1,0,0\n", 2, "has 3 columns where 4 are expected"),
        ("0,0,0,1,\n", 1, "has 5 columns, not 4 (t,x,y,z), 7 (and i,j,k) or 8"),
        ("0,0,0,1\n1,0,O,1\n", 2, '"O" is not a number'),
        ("0;0;0;1\n1;0,5;0;1\n", 2, '"0,5" is not a number (write 0.5)'),
        ("0,0,0,1\n1,1_0,0,1\n", 2, '"1_0" is not a number'),
        ("-1,0,0,1\n", 1, "t is before time 0: -1.0"),
        ("t,x,y,w\n0,0,0,0\n", 1, 'unknown column "w"'),
        ("t,x,y,z,degs\n0,0,0,0,1\n", 1, "(did you mean deg?)"),
        ("t,x,y\n0,0,0\n", 1, "column z is missing"),
        ("t,x,y,z,z\n0,0,0,0,0\n", 1, "column z stands twice"),
        ("t,x,y,z,i,j\n0,0,0,0,0,1\n", 1, "column k is missing (the orientation is i,j,k)"),
        ("t,x,y,z,i,j,k,ax,ay,az,deg\n", 1, "the orientation is given twice: by ax,ay,az,deg and by i,j,k"),
        ("0,0,0,0,0,0,0\n", 1, "the tool's axis i, j, k has no length"),
        ("0,0,0,0,0,0,0,5\n", 1, "the turn has no axis"),
        ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,1,0,0\n", 2, "the quaternion's length is 1.41421, not 1"),
    ],
)
def test_a_faulty_line_is_named(text: str, line: int, words: str) -> None:
    (fault,) = faults(text)
    assert fault.startswith(f"press.csv:{line}: ")
    assert words in fault


def test_all_faulty_lines_are_named_and_a_flood_is_counted() -> None:
    assert len(faults("0,0,0,nan\n1,0\n2,0,0,0\n1,0,0,0\n")) == 3
    flood = faults("0,0,0,0\n" + "x,0,0,0\n" * 1000)
    assert len(flood) == path_csv.LISTED_FAULTS + 1
    assert all(len(fault) < 250 and fault.isprintable() for fault in faults("\x00\x07" * 500 + ",0,0,1\n"))
    assert flood[-1] == "press.csv: and 980 faults more"


def test_files(tmp_path: Path) -> None:
    path = path_csv.parse("0,0,0,1\n2,0,0,0\n", "a")
    file = tmp_path / "press.csv"
    path_csv.write(file, path)
    np.testing.assert_array_equal(path_csv.read(file).at, path.at)
    file.write_bytes(b"\xef\xbb\xbft,x,y,z\r\n0,1,2,3\r\n")
    np.testing.assert_array_equal(path_csv.read(file).at, [[1, 2, 3]])


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("none.csv", None, "cannot be read: No such file"),
        ("empty.csv", b"", "holds no path"),
        ("comments.csv", b"# nothing\n\n", "holds no path"),
        ("header.csv", b"t,x,y,z\n", "holds no path"),
        ("latin.csv", b"0,0,0,1 # \xe4\n", "is no UTF-8 text: byte 10"),
        ("press.ngc", b"G0 X1\n", "the kinds that are read: .csv, .txt, .tsv"),
        ("press.apt", b"GOTO/1,2,3\n", "the kinds that are read: .csv, .txt, .tsv"),
    ],
)
def test_files_that_are_no_paths(tmp_path: Path, name: str, content: bytes | None, words: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        path_csv.read(tmp_path / name)
    assert words in str(caught.value)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)

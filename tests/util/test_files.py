import errno
import os
import stat
import sys
from pathlib import Path

import numpy as np
import pytest

from raytrace_jax import PictureError, RaytraceError, read_picture, write_exr, write_png
from raytrace_jax.util.files import atomic_write, read_bytes, write_text


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_writes_replaces_and_makes_folders(tmp_path):
    path = tmp_path / "new" / "folder" / "picture.exr"
    for content in ("first", "second"):
        with atomic_write(path) as temporary:
            assert temporary.parent == path.parent
            assert temporary.name.startswith(".picture.exr.part-")
            assert temporary.suffix == ".exr"
            temporary.write_text(content)
        assert path.read_text() == content
    assert names(path.parent) == ["picture.exr"]


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt, SystemExit])
def test_a_crash_leaves_only_the_old_file(tmp_path, failure):
    path = tmp_path / "picture.exr"
    path.write_text("old")
    with pytest.raises(failure), atomic_write(path) as temporary:
        temporary.write_text("half")
        raise failure
    assert path.read_text() == "old"
    assert names(tmp_path) == ["picture.exr"]


def test_links_and_rights_stay(tmp_path):
    ordinary, real, link = (tmp_path / name for name in ("ordinary", "real", "link"))
    ordinary.write_text("old")
    link.symlink_to("real")
    with atomic_write(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink() and real.read_text() == "new"
    assert stat.S_IMODE(real.stat().st_mode) == stat.S_IMODE(ordinary.stat().st_mode)


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "the disk is full"),
        (errno.EACCES, "is not writable"),
        (errno.EROFS, "is not writable"),
        (errno.EIO, os.strerror(errno.EIO)),
    ],
)
def test_system_errors_become_sentences(tmp_path, number, words):
    path = tmp_path / "picture.exr"
    with pytest.raises(PictureError, match=words) as caught, atomic_write(path, error=PictureError) as temporary:
        temporary.write_text("half")
        raise OSError(number, os.strerror(number))
    assert str(caught.value).startswith(f"{path}: cannot be written")
    assert names(tmp_path) == []


def test_refuses_what_is_no_ordinary_file(tmp_path):
    (tmp_path / "file").write_text("")
    os.mkfifo(tmp_path / "pipe")
    table = {
        tmp_path: "it is a folder",
        tmp_path / "pipe": "it is a device or a pipe",
        tmp_path / "file" / "picture.exr": "file is not a folder",
        tmp_path / ("n" * 300): "File name too long",
    }
    for path, words in table.items():
        with pytest.raises(RaytraceError, match=words), atomic_write(path) as temporary:
            temporary.write_text("never")
    assert names(tmp_path) == ["file", "pipe"]


def test_unreadable_files_are_explained(tmp_path):
    (tmp_path / "target.exr").write_text("")
    table = {
        tmp_path / "targte.exr": r"there is no such file; did you mean target\.exr\?$",
        tmp_path / "tager.exr": "there is no such file; did you mean",
        tmp_path / "tables.exr": "there is no such file$",
        tmp_path / "unlike": "there is no such file$",
        tmp_path / "nowhere" / "target.exr": "nor the folder .*nowhere",
        tmp_path: "is a folder",
        tmp_path / "target.exr" / "x": "Not a directory",
    }
    for path, words in table.items():
        with pytest.raises(RaytraceError, match=words) as caught:
            read_bytes(path)
        assert str(caught.value).startswith(str(Path(path)))


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are Unicode")
@pytest.mark.parametrize(("write", "name"), [(write_exr, b"\xff.exr"), (write_png, b"\xff.png")])
def test_a_picture_name_need_not_be_utf8(write, name, tmp_path):
    path = tmp_path / os.fsdecode(b"folder\xfe") / os.fsdecode(name)
    write(path, np.ones((3, 2, 4)))
    np.testing.assert_array_equal(read_picture(path), np.ones((3, 2, 4)))
    write_text(path, f"{path.name} and ü")
    assert path.read_text(encoding="utf-8") == f"\\udcff{path.suffix} and ü"

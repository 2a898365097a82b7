"""How our programs set JAX up: where they keep compiled programs, by the platform's custom, and with how many bits."""

import sys

import jax
import jax.numpy as jnp
import pytest
from command_line import run

from raytrace_jax import enable_compile_cache
from raytrace_jax.util import cache_folder as folders
from raytrace_jax.util import session
from raytrace_jax.util.compilation import keep_programs


@pytest.fixture
def unset():
    """JAX without a folder for compiled programs, while a test runs."""
    names = ["jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"]
    names += ["jax_persistent_cache_min_entry_size_bytes"]
    before = {name: getattr(jax.config, name) for name in names}
    jax.config.update("jax_compilation_cache_dir", None)
    yield
    keep_programs(None)
    for name, value in before.items():
        jax.config.update(name, value)


@pytest.mark.parametrize(
    ("platform", "variable", "folder"),
    [
        ("linux", "XDG_CACHE_HOME", "elsewhere/raytrace-jax"),
        ("darwin", None, "Library/Caches/raytrace-jax"),
        ("win32", "LOCALAPPDATA", "elsewhere/raytrace-jax"),
    ],
)
def test_the_cache_folder_is_the_platforms(platform, variable, folder, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "platform", platform)
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    if variable:
        monkeypatch.setenv(variable, str(tmp_path / "elsewhere"))
    assert folders.cache_folder() == tmp_path / folder


@pytest.mark.usefixtures("unset")
def test_a_writable_cache_folder_is_used(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "file").write_text("")
    with pytest.warns(UserWarning, match="compiled programs cannot be kept here"):
        enable_compile_cache(tmp_path / "file" / "folder")
    assert jax.config.jax_compilation_cache_dir is None
    enable_compile_cache()
    enable_compile_cache(tmp_path / "second")
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "raytrace-jax")
    assert (tmp_path / "raytrace-jax").is_dir() and not (tmp_path / "second").exists()


@pytest.mark.parametrize(("precision", "dtype"), [(32, jnp.float32), (64, jnp.float64)])
def test_a_session_sets_and_resets_precision(precision, dtype):
    before, devices = jax.config.jax_compilation_cache_dir, jax.device_count()
    with session.jax_session(precision, devices=devices + 1):
        assert jnp.asarray(0.5).dtype == dtype
        assert jax.device_count() == devices  # JAX runs already, as the suite has set it up.
    assert jnp.asarray(0.5).dtype == jnp.float64
    assert jax.config.jax_compilation_cache_dir == before


def test_the_version_tells_what_is_kept(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "raytrace-jax"

    def said():
        assert run("--version") == 0
        return capsys.readouterr().out.splitlines()[1]

    assert said() == f"compiled programs: {folder} (empty)" and not folder.exists()
    (folder / "programs" / "of-a-version").mkdir(parents=True)
    (folder / "programs" / "of-a-version" / "linearize-0").write_bytes(bytes(2_000_000))
    (folder / "jit_linearize-0-cache").write_bytes(bytes(3_000_000))
    (folder / "jit_linearize-0-atime").write_bytes(b"when")
    assert said() == f"compiled programs: {folder} (2 files, 5 MB)"
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "file" / "folder"))
    assert "it cannot be written, so that every start compiles anew" in said()

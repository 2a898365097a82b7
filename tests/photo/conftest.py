"""Boards that several tests of photographs look at."""

import pytest
from photographed_boards import WIDE, write_board

from raytrace_jax.photo.boards import read_board


@pytest.fixture(scope="session")
def board(tmp_path_factory):
    return read_board(write_board(tmp_path_factory.mktemp("board")))


@pytest.fixture(scope="session")
def wide_board(tmp_path_factory):
    return read_board(write_board(tmp_path_factory.mktemp("wide"), WIDE))

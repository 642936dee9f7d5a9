# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of make stability: what is written is read again, and nothing half of it is left."""

import pytest

from tests.bench.stability import cells, material, table

LINES = [
    cells.Row("local", "none", 1.0, 0.5, 0.0, "soft", 400.0, 400.0, 3002.0, 3010.0, 0.017, 0.67, -5e-4),
    material.Found("interpolate", "Touch", 10.0, 10.0, 5.0, "firm", 400.0, 0.97, 4e-4, 0.05, -7e-5, 0.8),
]


@pytest.mark.parametrize("line", LINES, ids=lambda line: type(line).__name__)
def test_a_table_is_read_as_it_was_written(tmp_path, line):
    path = tmp_path / "table.csv"
    table.write(type(line), [line, line], path)
    assert table.read(type(line), path) == [line, line]
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]


def test_what_cannot_be_written_leaves_the_former_table(tmp_path):
    path = tmp_path / "table.csv"
    table.write(cells.Row, LINES[:1], path)
    former = path.read_text()
    with pytest.raises(TypeError):
        table.write(cells.Row, [None], path)
    assert path.read_text() == former

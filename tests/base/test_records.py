"""Results on disk: what a killed run leaves, and what is refused."""

import json

import pytest

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.records import Records, whole_file, write_file

SETTINGS = {"method": "cascade", "norms": ("L4", "Linf"), "rtol": 1e-8}


def edit(comm, path, change):
    """Change the bytes of a file once, and let all ranks see it."""
    if comm.rank == 0:
        path.write_bytes(change(path.read_bytes() if path.exists() else b""))
    comm.barrier()


@pytest.fixture
def path(comm, folder):
    """A records file with three rows."""
    path = folder / "new" / "rows.jsonl"
    records = Records(comm, path, SETTINGS)
    for n in (1, 2, 3):
        records.append({"n": n, "errors": {"L4": 0.1 + n / 7}})
    return path


def rows_of(comm, path, settings=SETTINGS):
    return Records(comm, path, settings).rows


def test_rows_come_back_with_every_digit(comm, path):
    rows = rows_of(comm, path)
    assert [row["n"] for row in rows] == [1, 2, 3]
    assert [row["errors"]["L4"] for row in rows] == [0.1 + n / 7 for n in (1, 2, 3)]


def test_a_row_is_on_disk_when_append_returns(comm, path):
    records = Records(comm, path, SETTINGS)
    records.append({"n": 4})
    assert json.loads(path.read_text().splitlines()[-1]) == {"n": 4}
    assert records.rows[-1] == {"n": 4}


def test_all_ranks_hold_rank_0s_row(comm, path):
    records = Records(comm, path, SETTINGS)
    records.append({"n": 4, "rank": comm.rank})
    assert records.rows[-1]["rank"] == 0


@pytest.mark.parametrize("cut", [1, 5, 20])
def test_an_unfinished_last_line_is_dropped(comm, path, cut):
    edit(comm, path, lambda content: content[:-cut])
    records = Records(comm, path, SETTINGS)
    assert [row["n"] for row in records.rows] == [1, 2]
    records.append({"n": 5})
    assert [row["n"] for row in rows_of(comm, path)] == [1, 2, 5]


def test_every_cut_resumes_or_is_refused(comm, path):
    # Whatever byte a crash ends at: a prefix of the rows, or an error that names the file.
    content = path.read_bytes()
    comm.barrier()
    for length in range(0, len(content), 7 if comm.size == 1 else 41):
        edit(comm, path, lambda _, length=length: content[:length])
        try:
            rows = rows_of(comm, path)
        except InputError as error:
            assert "rows.jsonl" in str(error)
            assert length < content.index(b"\n") + 1  # only before the settings are whole
        else:
            assert [row["n"] for row in rows] == [1, 2, 3][: len(rows)]


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content.replace(b'{"n": 2', b'{"n" 2'),
        lambda content: content.replace(b'{"n": 2', b"\xff\xfe\x00"),
        lambda content: content.replace(b'{"n": 2', b"[2]\n{", 1),
        lambda content: b"x,y\n1,2\n",
        lambda content: b"\n".join(content.split(b"\n")[1:]),
        lambda content: b"\x00" * 100 + b"\n",
    ],
)
def test_a_corrupt_or_foreign_file_is_refused_and_kept(comm, path, damage):
    edit(comm, path, damage)
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"rows\.jsonl"):
        rows_of(comm, path)
    comm.barrier()
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("key", "value"), [("method", "bncg"), ("norms", ("L4",)), ("rtol", 1e-6), ("extra", 1)]
)
def test_other_settings_are_refused_by_name(comm, path, key, value):
    with pytest.raises(InputError, match=key):
        rows_of(comm, path, SETTINGS | {key: value})
    missing = {k: v for k, v in SETTINGS.items() if k != "rtol"}
    with pytest.raises(InputError, match="rtol"):
        rows_of(comm, path, missing)


def test_an_empty_file_counts_as_new(comm, folder):
    path = folder / "rows.jsonl"
    edit(comm, path, lambda _: b"")
    assert rows_of(comm, path) == []
    assert "settings" in json.loads(path.read_text())


def test_a_folder_that_cannot_be_made_is_named(comm, folder):
    edit(comm, folder / "file", lambda _: b"not a folder")
    with pytest.raises(InputError, match="file/results"):
        Records(comm, folder / "file" / "results" / "rows.jsonl", SETTINGS)


def test_a_folder_in_place_of_the_file_is_named(comm, folder):
    if comm.rank == 0:
        (folder / "rows.jsonl").mkdir()
    comm.barrier()
    with pytest.raises(InputError, match=folder.name):
        Records(comm, folder / "rows.jsonl", SETTINGS)


def test_files_are_whole_or_absent(comm, folder, monkeypatch):
    path = folder / f"table-{comm.rank}.txt"
    write_file(path, "old\n")
    monkeypatch.setattr("pathlib.Path.replace", lambda *a: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        write_file(path, "new\n")
    assert path.read_text() == "old\n"
    monkeypatch.undo()
    write_file(path, "new\n")
    assert path.read_text() == "new\n"


def test_unfinished_files_of_killed_runs_are_removed_and_those_of_live_runs_stay(serial, folder):
    left = folder / f".table.txt.{32 * '0'}.part"
    other = folder / f".other.txt.{32 * '0'}.part"
    left.touch()
    other.touch()
    with whole_file(folder / "other.txt") as file:  # somebody writes: what is unfinished may be his
        file.write(b"new")
        write_file(folder / "table.txt", "new")
        assert left.exists() and not other.exists()
    write_file(folder / "table.txt", "newer")
    assert sorted(path.name for path in folder.iterdir()) == ["other.txt", "table.txt"]


def test_a_row_that_lacks_a_key_is_refused(comm, folder):
    path = folder / "rows.jsonl"
    Records(comm, path, SETTINGS).append({"m": 1})
    with pytest.raises(InputError, match="line 2: not a row"):
        Records(comm, path, SETTINGS, keys=("n",))


def test_a_row_that_cannot_be_written_is_refused_on_all_ranks(comm, folder):
    path = folder / "rows.jsonl"
    records = Records(comm, path, SETTINGS)
    comm.barrier()
    if comm.rank == 0:
        path.unlink()
        path.mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        records.append({"n": 1})

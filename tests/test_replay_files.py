"""Recorded episodes as files: the archive and the table."""

from __future__ import annotations

import csv
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replays import flown
from tables_in_docs import ROOT

from baselines.replay import Episode, read, table, write, write_table
from baselines.replay.archive import _ARRAYS
from baselines.replay.episode import Episode as Recorded
from formation_env.task import FAILURES

CASES = [
    ("expert", {"scenario": "nominal"}),
    ("random", {"scenario": "paper", "duration": 40.0}),
    ("hover", {"scenario": "swarm", "action": "reference", "duration": 0.5}),
    ("hover", {"scenario": "agile", "duration": 0.5}),
]


@pytest.mark.parametrize(("policy", "fields"), CASES)
def test_an_archive_gives_the_episode_back(
    tmp_path: Path, policy: str, fields: dict[str, Any]
) -> None:
    episode = flown(policy, 3, **fields)._replace(policy="<b>né</b>")
    again = read(write(episode, tmp_path / "flight"))
    assert (tmp_path / "flight.npz").exists()
    for name in Episode._fields:
        one, other = getattr(episode, name), getattr(again, name)
        if isinstance(one, np.ndarray):
            assert one.dtype == other.dtype
            assert np.array_equal(one, other, equal_nan=True), name
        elif name == "metrics":
            assert one == pytest.approx(other, nan_ok=True, rel=0.0)
        else:
            assert one == other, name


def test_a_last_instant_that_cannot_be_computed_is_kept(tmp_path: Path) -> None:
    episode = flown("random", 3, scenario="paper", duration=40.0)
    positions = episode.positions.copy()
    positions[-1, 1] = np.nan
    again = read(write(episode._replace(positions=positions), tmp_path / "flight.npz"))
    assert np.array_equal(again.positions, positions, equal_nan=True)


def damaged(folder: Path, **changes: Any) -> Path:
    """The archive of an episode with other arrays; without those that are None."""
    with np.load(write(flown(), folder / "whole.npz")) as file:
        arrays = {name: file[name] for name in file.files}
    header = json.loads(bytes(arrays["header"]))
    header |= changes.pop("into_header", {})
    header = {name: value for name, value in header.items() if value != "left out"}
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    arrays |= changes
    file = folder / "damaged.npz"
    np.savez(file, **{name: x for name, x in arrays.items() if x is not None})
    return file


def nan_at(name: str, j: int) -> dict[str, Any]:
    array = getattr(flown(), name).copy()
    array[j] = np.nan
    return {name: array}


HOSTILE: list[tuple[dict[str, Any], str]] = [
    *[({name: None}, f"array '{name}' is missing") for name in (*_ARRAYS, "header")],
    *[({name: np.zeros((3, 2, 9))}, f"array '{name}'") for name in _ARRAYS],
    *[
        (nan_at(name, 4), f"array '{name}' holds numbers that are not finite")
        for name in ("positions", "attitudes", "actions", "path", "lyapunov", "time")
    ],
    (nan_at("slots", -1), "array 'slots' holds numbers that are not finite"),
    ({"time": flown().time.astype(np.float32)}, "expected float64 (101,)"),
    ({"time": flown().time[::-1].copy()}, "expected times that increase"),
    ({"time": np.zeros(1)}, "expected at least two instants"),
    ({"time": np.float64(3.0)}, "expected at least two instants"),
    ({"failure": np.array([0, len(FAILURES)])}, "expected indices from 0 to"),
    ({"positions": np.array([object()])}, "array 'positions' cannot be read without pickle"),
    ({"header": np.array([object()])}, "array 'header' cannot be read without pickle"),
    ({"header": np.zeros(3)}, "header: expected the JSON object"),
    ({"header": np.frombuffer(b"[]", dtype=np.uint8)}, "header: expected the JSON object"),
    ({"header": np.frombuffer(b"[" * 100000, dtype=np.uint8)}, "header: expected the JSON object"),
    ({"header": np.array(["x"])}, "header: expected the JSON object"),
    ({"into_header": {"format": "other"}}, "header: expected the JSON object"),
    ({"into_header": {"version": 99}}, "version = 99: expected 1"),
    ({"into_header": {"policy": 3}}, "expected a policy's name"),
    ({"into_header": {"seed": -1}}, "a seed of at least 0"),
    ({"into_header": {"seed": "x"}}, "a seed of at least 0"),
    ({"into_header": {"config": {"gust": -1.0}}}, "gust = -1.0"),
    ({"into_header": {"config": {"guts": 1.0}}}, "data['guts']"),
    ({"into_header": {"config": 3}}, "a dictionary of a configuration's fields"),
    ({"into_header": {"config": "left out"}}, "config is missing"),
    ({"into_header": {"metrics": {}}}, "score is missing"),
    ({"into_header": {"metrics": {"score": "x"}}}, "could not convert"),
    ({"into_header": {"metrics": 3}}, "expected metrics by name"),
]


@pytest.mark.parametrize(("changes", "expected"), HOSTILE)
def test_a_damaged_archive_is_one_clear_error(
    tmp_path: Path, changes: dict[str, Any], expected: str
) -> None:
    path = damaged(tmp_path, **changes)
    with pytest.raises(ValueError, match=r"no episode of baselines\.replay") as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert expected in message
    assert "\n" not in message
    assert len(message) < 600


def test_what_is_no_archive_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flight.npz"
    with pytest.raises(ValueError, match=r"flight\.npz: cannot be read: No such file"):
        read(path)
    for data in (b"", b"nothing of the kind", b"PK\x03\x04" + bytes(40)):
        path.write_bytes(data)
        with pytest.raises(ValueError, match="expected a NumPy archive"):
            read(path)
    whole = write(flown(), tmp_path / "whole.npz").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="expected a NumPy archive"):
        read(path)
    middle = whole.index(b"positions.npy") + 200
    path.write_bytes(whole[:middle] + bytes(64) + whole[middle + 64 :])
    with pytest.raises(ValueError, match="array 'positions' cannot be read"):
        read(path)
    with pytest.raises(ValueError, match="cannot be read: "):
        read(tmp_path)
    with pytest.raises(ValueError, match="path = 3: expected the name of a file"):
        read(3)  # type: ignore[arg-type]


def test_an_archive_that_unpacks_to_too_much_is_not_unpacked(tmp_path: Path) -> None:
    path, zeros = tmp_path / "bomb.npz", io.BytesIO()
    np.save(zeros, np.zeros(2**20))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(70):
            archive.writestr(f"{k}.npy", zeros.getvalue())
    assert path.stat().st_size < 2**20
    with pytest.raises(ValueError, match="bytes of arrays: expected at most 536870912"):
        read(path)


# -- the table --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("policy", "fields"), CASES)
def test_the_table_holds_the_same_numbers(
    tmp_path: Path, policy: str, fields: dict[str, Any]
) -> None:
    e: Recorded = flown(policy, 3, **fields)
    path = write_table(e, tmp_path / "flight.csv")
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    vehicles = e.config.followers + 1
    assert len(rows) == len(e.time) * vehicles
    assert list(rows[0]) == list(table.columns(e))

    def numbers(row: dict[str, str], name: str, axes: str) -> list[float]:
        return [float(row[f"{name}_{axis}"]) for axis in axes]

    for k, row in enumerate(rows):
        j, i = divmod(k, vehicles)
        assert row["vehicle"] == ("leader" if i == 0 else f"follower_{i - 1}")
        assert float(row["time"]) == e.time[j]
        assert row["started"] == str(int(e.started[j]))
        assert numbers(row, "position", "xyz") == e.positions[j, i].tolist()
        assert numbers(row, "velocity", "xyz") == e.velocities[j, i].tolist()
        assert numbers(row, "attitude", "wxyz") == e.attitudes[j, i].tolist()
        assert numbers(row, "angular_velocity", "xyz") == e.angular_velocities[j, i].tolist()
        last = j == len(e.time) - 1
        if i == 0 or last:
            assert row["action_0"] == row["reward"] == row["V4"] == ""
        else:
            k = e.config.action_size
            commanded = [np.float32(row[f"action_{m}"]) for m in range(k)]
            assert commanded == e.actions[j, i - 1].tolist()
            assert float(row["reward"]) == e.rewards[j, i - 1]
            laws = [row[f"V{m}"] for m in (1, 2, 3, 4)]
            expected = (
                [repr(x) for x in e.lyapunov[j, i - 1].tolist()] if len(e.lyapunov) else [""] * 4
            )
            assert laws == expected
        if i == 0:
            assert row["slot_x"] == row["slot_error"] == ""
        else:
            slot = np.array(numbers(row, "slot", "xyz"))
            assert slot.tolist() == e.slots[j, i - 1].tolist()
            far = np.linalg.norm(slot - e.positions[j, i])
            assert float(row["slot_error"]) == pytest.approx(far, rel=1e-12)


def test_the_columns_are_documented() -> None:
    text = (ROOT / "docs" / "seeing.md").read_text(encoding="utf-8")
    assert table.described() in text, f"docs/seeing.md should hold:\n{table.described()}"

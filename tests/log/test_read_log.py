"""Logs as loggers and spreadsheets write them: what is taken as it is, and what is refused in one line."""

import tracemalloc

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from ndob_fmu.errors import MESSAGE_LIMIT, UsageError
from ndob_fmu.log.log import Found
from ndob_fmu.log.log_columns import Signals
from ndob_fmu.log.read_log import read_log

SIGNALS = Signals(["u"], ["y", "z"], {"y": "rad"}, {}, {})


def written(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_text(text, "utf-8")
    return path


def whole(path, signals=SIGNALS, block=100):
    logs = list(read_log(path, signals, block))
    columns = [np.concatenate([getattr(log, name) for log in logs]) for name in ("time", "inputs", "outputs")]
    return (*columns, sum((log.found for log in logs), Found()))


PLAIN = "time,u,y,z\n0.0,1,2,3\n0.1,4,5,6\n0.25,7,8,9\n"


def test_the_columns_are_found_by_their_names_in_any_order(tmp_path):
    time, inputs, outputs, found = whole(written(tmp_path, "z,extra,time,y,u\n3,text,0.5,2,1\n6,,0.6,5,4\n"))
    assert time.tolist() == [0.5, 0.6]
    assert inputs.tolist() == [[1.0], [4.0]]
    assert outputs.tolist() == [[2.0, 3.0], [5.0, 6.0]]
    assert found == Found(rows=2)


@pytest.mark.parametrize(
    "text",
    [
        PLAIN.replace(",", ";"),
        PLAIN.replace(",", "\t"),
        PLAIN.replace(",", ";").replace(".", ","),
        "# a logger's remark\n" + PLAIN,
        "\ufeff" + PLAIN.replace("\n", "\r\n"),
        PLAIN.replace("time,u", '"time", "u"'),
        PLAIN + "\n\n",
    ],
    ids=["semicolons", "tabs", "decimal commas", "a remark", "of a spreadsheet", "quotes", "empty lines"],
)
def test_other_ways_to_write_the_same_numbers_are_read_too(tmp_path, text):
    expected = whole(written(tmp_path, PLAIN, "plain.csv"))
    for own, plain in zip(whole(written(tmp_path, text)), expected, strict=True):
        np.testing.assert_equal(own, plain)


def test_columns_of_other_names_and_units_are_converted(tmp_path):
    signals = Signals(["u"], ["y", "z"], {"y": "rad"}, {"t": "time", "angle": "y"}, {"t": "ms", "angle": "deg"})
    time, _, outputs, _ = whole(written(tmp_path, "t,u,angle,z,y\n500,1,180,3,0\n600,1,90,3,0\n"), signals)
    np.testing.assert_allclose(time, [0.5, 0.6], rtol=1e-15)
    np.testing.assert_allclose(outputs[:, 0], [np.pi, np.pi / 2], rtol=1e-15)


def test_missing_entries_are_samples_not_taken_and_inputs_held(tmp_path):
    text = "time,u,y,z\n0,,1,\n1,5,NaN,2\n2,,n/a,null\n3,inf,4,5\n4,true,4,5\n"
    _, inputs, outputs, found = whole(written(tmp_path, text))
    assert inputs[:, 0].tolist() == [5.0, 5.0, 5.0, 5.0, 1.0]
    np.testing.assert_equal(outputs, [[1, np.nan], [np.nan, 2], [np.nan, np.nan], [4, 5], [4, 5]])
    assert found == Found(rows=5, missing_inputs=3, missing_samples=4)


@pytest.mark.parametrize("block", [1, 2, 100])
def test_an_entry_may_go_on_in_the_next_line(tmp_path, block):
    rows = [f"{k},1,{2 * k},3," for k in range(5)]
    plain = "time,u,y,z,note\n" + "\n".join(rows)
    text = "time,u,y,z,note\n" + "\n".join([*rows[:2], rows[2] + '"two\nlines"', *rows[3:]])
    own, expected = (
        np.concatenate([log.outputs for log in read_log(written(tmp_path, one, name), SIGNALS, block)])
        for one, name in ((text, "notes.csv"), (plain, "plain.csv"))
    )
    np.testing.assert_equal(own, expected)


def test_rows_of_one_time_are_one_sample(tmp_path):
    """As loggers write sensors that come one after the other."""
    text = "time,u,y,z\n0,1,2,\n0,1,,3\n1,4,5,6\n1,4,7,\n"
    time, _, outputs, found = whole(written(tmp_path, text))
    assert time.tolist() == [0.0, 1.0]
    assert outputs.tolist() == [[2.0, 3.0], [7.0, 6.0]]
    assert found == Found(rows=4, merged=2, overwritten=1)


@pytest.mark.parametrize("block", [3, 1000])
def test_times_with_too_few_digits_are_named_where_they_leave_samples_out(tmp_path, block):
    times = np.round(1.7e9 + 0.005 * np.arange(400), 2)
    found = whole(
        written(tmp_path, "time,u,y,z\n" + "".join(f"{t:.2f},1,{k},0\n" for k, t in enumerate(times))), block=block
    )[3]
    (line,) = found.warnings
    assert line.startswith(
        f"{400 - len(set(times.tolist()))} of 400 rows have the time of the row before and other samples"
    )


def test_repeated_rows_and_sensors_that_come_one_after_the_other_leave_no_sample_out(tmp_path):
    text = "time,u,y,z\n" + "".join(f"{k},1,{k},\n{k},1,,{k}\n{k},2,{k},{k}\n" for k in range(9))
    assert whole(written(tmp_path, text))[3] == Found(rows=27, merged=18)


@pytest.mark.parametrize("block", [1, 2, 3, 7])
def test_the_blocks_of_a_log_are_together_the_log(tmp_path, block):
    rows = "".join(f"{t},{'' if t % 3 else t},{'' if t % 4 else -t},{t}\n" for t in (0, 1, 1, 2, 2, 2, 3, 5, 8, 8))
    path = written(tmp_path, "time,u,y,z\n" + rows)
    for own, expected in zip(whole(path, block=block), whole(path), strict=True):
        np.testing.assert_equal(own, expected)


def test_parquet_holds_the_same_log(tmp_path):
    table = pyarrow.table(
        {
            "y": [2, 5, None],
            "time": [0.0, 0.1, 0.25],
            "u": [1.0, 4.0, 7.0],
            "z": [3.0, 6.0, 9.0],
            "note": ["a", "b", "c"],
        }
    )
    pyarrow.parquet.write_table(table, tmp_path / "log.parquet")
    time, inputs, outputs, _ = whole(tmp_path / "log.parquet")
    assert time.tolist() == [0.0, 0.1, 0.25]
    assert inputs[:, 0].tolist() == [1.0, 4.0, 7.0]
    np.testing.assert_equal(outputs, [[2, 3], [5, 6], [np.nan, 9]])


REFUSED = {
    "empty": ("", "an empty file"),
    "a header only": ("time,u,y,z\n", "received no rows"),
    "one row": ("time,u,y,z\n0,1,2,3\n", "received 1 with one time"),
    "a column is missing": ("time,u,y\n0,1,2\n", "a column z"),
    "text": ("time,u,y,z\n0,1,2,3\n1,1,on,3\n", "row 2, column y: expected a number, received 'on'"),
    "decimal commas between commas": (
        'time,u,y,z\n0,1,2,"3,5"\n',
        "received '3,5'; likely cause: a decimal comma, in a",
    ),
    "a date": ("time,u,y,z\n2026-11-30T06:00:00,1,2,3\n", "a date or a time of day; write the time in seconds"),
    "a time of day": ("time,u,y,z\n06:00:00.5,1,2,3\n", "a date or a time of day"),
    "a row of units": ("time,u,y,z\ns,N,m,[m/s]\n0,1,2,3\n", "a second row of the header, as of units; delete it"),
    "a unit behind a number": ("time,u,y,z\n0,1,2.5 mm,3\n", "a unit behind the number; leave it out"),
    "a short row": ("time,u,y,z\n0,1,2,3\n1,1\n", "row 2: expected 4 entries, as in the header, received 2"),
    "a time goes back": ("time,u,y,z\n2,1,2,3\n1,1,2,3\n", "row 2: expected a time of at least 2 s"),
    "a clock goes back": (
        "time,u,y,z\n1700000000.02,1,2,3\n1700000000.01,1,2,3\n",
        "at least 1700000000.02 s, that of the row before, received 1700000000.01 s",
    ),
    "a time is missing": ("time,u,y,z\n2,1,2,3\n,1,2,3\n", "row 2: expected a time, received none"),
    "an input without numbers": ("time,u,y,z\n0,,2,3\n1,,2,3\n", "numbers in the column of u"),
    "no text at all": ("\x00\x01\x02", "expected columns time, u, y, z, received"),
    "several columns": ("a,u,b,c\n0,1,2,3\n", "expected columns time, y, z, received columns a, u, b, c; likely"),
}


@pytest.mark.parametrize("block", [1, 100])
@pytest.mark.parametrize(("text", "part"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_log_is_refused_in_one_line(tmp_path, text, part, block):
    path = written(tmp_path, text)
    with pytest.raises(UsageError) as refusal:
        list(read_log(path, SIGNALS, block))
    line = str(refusal.value)
    assert part in line
    assert "\n" not in line
    assert len(line) < MESSAGE_LIMIT


@pytest.mark.parametrize(
    ("names", "units", "part"),
    [
        ({"a": "y"}, {}, "--map a: expected a column of"),
        ({"y": "speed"}, {}, "--map y=speed: expected"),
        ({}, {"a": "deg"}, "--unit a: expected a column of"),
        ({}, {"y": "kg"}, "--unit y=kg: expected a unit that can become rad"),
        ({}, {"y": "Deg"}, "likely cause: did you mean 'deg'?"),
        ({}, {"z": "mm"}, "--unit z=mm: expected a unit of z in the model"),
        ({}, {"z": "%"}, 'likely cause: units={"z": "1"} is missing in the model'),
    ],
)
def test_names_and_units_that_do_not_fit_are_refused(tmp_path, names, units, part):
    path = written(tmp_path, PLAIN)
    with pytest.raises(UsageError, match=part):
        list(read_log(path, Signals(["u"], ["y", "z"], {"y": "rad"}, names, units)))


@pytest.mark.parametrize(
    ("names", "units", "part"),
    [
        ({"y": "LT 1"}, {}, 'it is the other way round: --map "LT 1=y"'),
        ({"LT 1": "y"}, {"deg": "LT 1"}, 'it is the other way round: --unit "LT 1=deg"'),
        ({"LT 1": "y"}, {"y": "deg"}, 'a column has its name in the log: --unit "LT 1=deg"'),
    ],
)
def test_a_name_on_the_wrong_side_is_told_with_the_right_one(tmp_path, names, units, part):
    path = written(tmp_path, PLAIN.replace("y", "LT 1"))
    with pytest.raises(UsageError, match=part):
        list(read_log(path, Signals(["u"], ["y", "z"], {"y": "rad"}, names, units)))


@pytest.mark.parametrize("name", ["none.csv", "none.parquet", "folder"])
def test_what_cannot_be_opened_is_refused(tmp_path, name):
    (tmp_path / "folder").mkdir()
    with pytest.raises(UsageError, match=r"expected a readable CSV file|expected a Parquet file"):
        list(read_log(tmp_path / name, SIGNALS))


def test_a_log_may_be_larger_than_the_memory_that_reading_takes(tmp_path):
    path = tmp_path / "log.csv"
    with path.open("w") as file:
        file.write("time,u,y,z\n")
        file.writelines(f"{k / 1000},1.5,2.5,3.5\n" for k in range(100_000))
    tracemalloc.start()
    try:
        rows = sum(len(log.time) for log in read_log(path, SIGNALS, 1000))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert rows == 100_000
    assert peak < path.stat().st_size / 2

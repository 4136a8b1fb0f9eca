import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coordlog.episode import Result
from coordlog.errors import FormatError, SpecError
from coordlog.record.metadata import (
    HEADER_RECORDS,
    decode,
    decode_header,
    decode_result,
    encode,
    encode_header,
    encode_result,
)
from tests.synthetic import make_header

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@given(st.dictionaries(st.text(), json_values, max_size=6))
def test_any_json_survives_exactly(values):
    decoded = decode(encode(values))
    assert decoded == values
    assert repr(decoded) == repr(values)  # types and order too: 1 is not 1.0, nor True


@given(st.floats(allow_nan=False))
def test_floats_keep_every_bit(value):
    (decoded,) = decode(encode({"x": value})).values()
    assert decoded.hex() == value.hex()


@pytest.mark.parametrize(
    "text",
    ["", "5", "1e999", "null", "true", '"quoted"', "NaN", "[1]", " 5 ", "{", "µ", "5 m", "-"],
)
def test_a_string_stays_a_string(text):
    assert decode(encode({"key": text})) == {"key": text}


def test_plain_strings_stand_as_they_are_and_the_rest_is_json():
    assert encode({"scene": "table", "seed": 3, "goals": [[1.5]]}) == {
        "scene": "table",
        "seed": "3",
        "goals": "[[1.5]]",
    }


def test_nan_and_infinity_survive():
    decoded = decode(encode({"x": [math.nan, math.inf]}))["x"]
    assert math.isnan(decoded[0])
    assert decoded[1] == math.inf


def test_what_json_cannot_hold_is_refused_by_name():
    with pytest.raises(SpecError, match=r"'when'.*set"):
        encode({"when": {1, 2}})


def test_header_survives_with_the_order_of_its_arms():
    header = make_header()
    decoded = decode_header(encode_header(header))
    assert decoded == header
    assert decoded.arms == ("right", "left")


def test_result_survives():
    result = Result(
        3, (0.1, -1 / 3), True, False, True, False, "", "1234" * 16
    )  # a digest that would read as a number
    assert decode_result(encode_result(result)) == result


@pytest.mark.parametrize("name", HEADER_RECORDS)
def test_a_missing_record_is_named(name):
    records = encode_header(make_header())
    del records[name]
    with pytest.raises(FormatError, match=name):
        decode_header(records)


@pytest.mark.parametrize("key", ["layout", "arms", "joints"])
def test_a_missing_key_is_named(key):
    records = encode_header(make_header())
    del records["coordlog.env"][key]
    with pytest.raises(FormatError, match=f"coordlog.env: '{key}': expected"):
        decode_header(records)


def test_another_schema_version_is_refused():
    records = encode_header(make_header())
    records["coordlog.episode"]["schema_version"] = "3"
    said = (
        "schema version 3; this release reads versions 1 to 2: a release .* that writes version 3"
    )
    with pytest.raises(FormatError, match=said):
        decode_header(records)


def test_a_result_with_a_value_of_another_type_is_refused():
    strings = encode_result(Result(3, (0.1,), True, False, True, False, "", "00"))
    with pytest.raises(FormatError, match="'length': expected a whole number from 0, got 'three'"):
        decode_result(strings | {"length": "three"})
    with pytest.raises(FormatError, match="'returns': expected a list of numbers"):
        decode_result(strings | {"returns": json.dumps(1.0)})


@pytest.mark.parametrize(
    ("key", "value"), [("n_q", -1), ("n_x", 10**12), ("k", 2.0), ("n_u", True)]
)
def test_a_layout_that_cannot_be_is_refused(key, value):
    header = make_header()
    header.env["layout"][key] = value
    with pytest.raises(FormatError, match=f"coordlog.env layout: '{key}': expected .* got {value}"):
        decode_header(encode_header(header))


@pytest.mark.parametrize("start_time", [-1, 2**63])
def test_a_start_that_no_log_time_can_hold_is_refused(start_time):
    with pytest.raises(FormatError, match="'start_time': expected 0 to"):
        decode_header(encode_header(make_header(start_time=start_time)))


def test_deep_nesting_is_text():
    assert decode({"key": "[" * 100_000}) == {"key": "[" * 100_000}

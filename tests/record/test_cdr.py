"""The codec against mcap-ros2-support, which decodes from the schema text alone and knows nothing
of our layout."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic

from coordlog.errors import FormatError
from coordlog.record.cdr import joint_state_codec, message_codec
from coordlog.record.schema import SCHEMAS
from coordlog.spec import INPUTS, JOINT_STATE_NAME, MESSAGES, STEP, Layout

layouts = st.builds(Layout, *(st.integers(1, 40) for _ in range(4)), st.integers(1, 5))


def random_columns(rng, message, layout, n, contacts):
    columns = {}
    for item in message.fields:
        width = contacts if item.size == "c" else layout.width(item)
        shape = (n,) if width is None else (n, width)
        columns[item.name] = rng.integers(
            0, 256, (*shape, np.dtype(item.type).itemsize), np.uint8
        ).view(item.type)[..., 0]
        if item.type == "bool":
            columns[item.name] = rng.random(shape) < 0.5
        if item.type.startswith("float"):
            columns[item.name][~np.isfinite(columns[item.name])] = 0
    return columns


def encoded(codec, columns, n):
    rows = np.frombuffer(bytearray(codec.template * n), codec.dtype)
    codec.encode(rows, columns)
    return rows


@given(
    layout=layouts,
    contacts=st.integers(1, 7),
    message=st.sampled_from([item for item in MESSAGES if item is not INPUTS]),
    seed=st.integers(0, 2**32),
)
def test_an_independent_decoder_reads_what_was_encoded(layout, contacts, message, seed):
    columns = random_columns(np.random.default_rng(seed), message, layout, 3, contacts)
    codec = message_codec(message, layout, contacts)
    rows = encoded(codec, columns, 3)
    decode = generate_dynamic(message.name, SCHEMAS[message.name])[message.name]
    for index, row in enumerate(rows):
        got = decode(row.tobytes())
        for item in message.fields:
            assert np.array_equal(getattr(got, item.name), columns[item.name][index]), item.name


@given(
    layout=layouts,
    contacts=st.integers(1, 7),
    message=st.sampled_from([item for item in MESSAGES if item is not INPUTS]),
    seed=st.integers(0, 2**32),
)
def test_an_independent_encoder_writes_the_same_bytes(layout, contacts, message, seed):
    columns = random_columns(np.random.default_rng(seed), message, layout, 2, contacts)
    rows = encoded(message_codec(message, layout, contacts), columns, 2)
    encode = serialize_dynamic(message.name, SCHEMAS[message.name])[message.name]
    for index, row in enumerate(rows):
        assert (
            encode({name: column[index].tolist() for name, column in columns.items()})
            == row.tobytes()
        )


@given(
    layout=layouts,
    contacts=st.integers(1, 7),
    message=st.sampled_from([item for item in MESSAGES if item is not INPUTS]),
    seed=st.integers(0, 2**32),
)
def test_decoding_inverts_encoding_bit_for_bit(layout, contacts, message, seed):
    columns = random_columns(np.random.default_rng(seed), message, layout, 4, contacts)
    codec = message_codec(message, layout, contacts)
    decoded = codec.decode(encoded(codec, columns, 4))
    assert list(decoded) == [item.name for item in message.fields]
    for name, column in columns.items():
        assert decoded[name].dtype == column.dtype
        assert decoded[name].tobytes() == column.tobytes(), name


@given(
    names=st.lists(st.text("abcdefgh_µ", min_size=1, max_size=9), max_size=8),
    seed=st.integers(0, 2**32),
)
def test_joint_state_reads_independently(names, seed):
    rng = np.random.default_rng(seed)
    columns = {"sec": np.array([1_700_000_000]), "nanosec": np.array([999_999_999])}
    columns |= {name: rng.normal(size=(1, len(names))) for name in ("position", "velocity")}
    got = generate_dynamic(JOINT_STATE_NAME, SCHEMAS[JOINT_STATE_NAME])[JOINT_STATE_NAME](
        encoded(joint_state_codec(tuple(names)), columns, 1).tobytes()
    )
    assert got.name == names
    assert (got.header.stamp.sec, got.header.stamp.nanosec, got.header.frame_id) == (
        1_700_000_000,
        999_999_999,
        "",
    )
    assert got.position == columns["position"][0].tolist()
    assert got.velocity == columns["velocity"][0].tolist()
    assert got.effort == []


def test_every_constant_byte_is_verified_and_named():
    layout = Layout(3, 2, 5, 1, 2)
    codec = message_codec(STEP, layout)
    rows = encoded(codec, random_columns(np.random.default_rng(1), STEP, layout, 2, 0), 2)
    assert len(codec.fixed) > 4 * 8
    for at, label in zip(codec.fixed, codec.label, strict=True):
        damaged = bytearray(rows.tobytes())
        damaged[codec.dtype.itemsize + at] ^= 1
        with pytest.raises(FormatError, match=f"Step message 1: {label}: expected byte"):
            codec.decode(np.frombuffer(damaged, codec.dtype))
    assert "length of qpos" in codec.label
    assert "padding before reward" in codec.label


def test_a_bool_that_is_neither_0_nor_1_is_refused():
    layout = Layout(1, 1, 1, 1, 1)
    codec = message_codec(STEP, layout)
    damaged = bytearray(
        encoded(codec, random_columns(np.random.default_rng(1), STEP, layout, 1, 0), 1).tobytes()
    )
    damaged[-1] = 2
    with pytest.raises(FormatError, match="bool"):
        codec.decode(np.frombuffer(damaged, codec.dtype))

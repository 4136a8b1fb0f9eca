import zlib

from hypothesis import given
from hypothesis import strategies as st

from coordlog.verify.bitflip import Flip, locate, restored


@given(st.binary(min_size=1, max_size=300), st.data())
def test_the_flipped_bit_is_found_and_put_back(data, draw):
    flip = Flip(draw.draw(st.integers(0, len(data) - 1)), draw.draw(st.integers(0, 7)))
    damaged = restored(data, flip)
    assert damaged != data
    assert locate(damaged, zlib.crc32(data)) == flip
    assert restored(damaged, flip) == data


@given(st.binary(min_size=2, max_size=300), st.data())
def test_damage_of_two_bits_is_not_taken_for_one(data, draw):
    places = draw.draw(
        st.lists(st.integers(0, len(data) * 8 - 1), min_size=2, max_size=2, unique=True)
    )
    damaged = data
    for place in places:
        damaged = restored(damaged, Flip(place // 8, place % 8))
    assert locate(damaged, zlib.crc32(data)) is None


def test_undamaged_data_has_no_flip():
    assert locate(b"coordlog", zlib.crc32(b"coordlog")) is None
    assert locate(b"", 0) is None

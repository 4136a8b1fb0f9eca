from pathlib import Path

import pytest

from coordlog.record.schema import SCHEMAS, write
from coordlog.spec import MESSAGES

CHECKED_IN = Path(__file__).parents[2] / "schemas"


def test_checked_in_schemas_are_the_generated_ones(tmp_path):
    write(tmp_path)
    generated = {path.relative_to(tmp_path): path.read_text() for path in tmp_path.rglob("*.msg")}
    assert generated == {
        path.relative_to(CHECKED_IN): path.read_text() for path in CHECKED_IN.rglob("*.msg")
    }
    assert len(generated) == len(MESSAGES)


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
def test_schema_declares_the_fields_of_the_table_in_order(message):
    declared = [
        line.split("  #")[0].split()
        for line in SCHEMAS[message.name].splitlines()
        if line and not line.startswith("#")
    ]
    assert declared == [
        [item.type + ("[]" if item.size else ""), item.name] for item in message.fields
    ]


def test_every_field_says_what_it_is():
    for message in MESSAGES:
        for item in message.fields:
            (line,) = [
                line
                for line in SCHEMAS[message.name].splitlines()
                if line.split()[1:2] == [item.name] and not line.startswith("#")
            ]
            assert item.doc in line
            assert f"[{item.unit}]" in line or not item.unit

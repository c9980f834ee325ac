"""The layout for Foxglove and Lichtblick names what a log has."""

import json
from pathlib import Path

from mcap.reader import make_reader

from bench.record.foxglove_layout import layout
from bench.record.layout import message_class

SHIPPED = Path(__file__).parents[2] / "docs" / "foxglove-layout.json"


def fields_of(path):
    """The names of each topic's fields."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    fields = {}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        descriptor = message_class(schema.name, schema.data).DESCRIPTOR
        fields[channel.topic] = {field.name for field in descriptor.fields}
    return fields


def panels_of(tree):
    return [tree] if isinstance(tree, str) else [*panels_of(tree["first"]), *panels_of(tree["second"])]


def test_every_topic_and_field_is_in_a_log(recorded):
    fields = fields_of(recorded.path)
    made = layout(2)
    named = [path["value"] for panel in made["configById"].values() for path in panel.get("paths", ())]
    assert len(named) > 16
    for value in named:
        topic, _, field = value.rpartition(".")
        assert field in fields[topic], value
    topics = {topic for panel in made["configById"].values() for topic in panel.get("topics", ())}
    topics.add(made["configById"]["RosOut!events"]["topicToRender"])
    assert topics == {"/scene", "/plan/veh1", "/plan/veh2", "/events"}
    assert topics <= fields.keys()


def test_every_panel_has_its_place_once():
    made = layout(3)
    assert sorted(panels_of(made["layout"])) == sorted(made["configById"])


def test_the_shipped_file_is_made_for_three_vehicles():
    assert json.loads(SHIPPED.read_text()) == layout(3)

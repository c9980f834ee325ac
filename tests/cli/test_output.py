"""What reaches the terminal: text from elsewhere controls nothing, in every command, in a pipe and on a tty."""

import json
import os
import pty
import re
import subprocess
import sys
import textwrap
import unicodedata
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Metadata, Schema
from mcap.writer import Writer

from bench.cli.output import LONGEST_LINE, escaped, one_line, shown
from tests.record.damage import make_log

ROOT = Path(__file__).parents[2]

C1 = "".join(map(chr, range(0x80, 0xA0)))
UNSEEN = "\u200b\u200d\u2060\ufeff\u3164\u2800\ufe0f\U000e0041"
BIDI = "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
SEPARATORS = "\u2028\u2029\u00a0"
SEQUENCES = "\x1b]0;title\x07\x1b]52;c;ZXZpbA==\x07\x1b[31mRED\x1b[0m\x1b[2J\x9b31m\x9d0;x\x9c"
SEQUENCES += "\x1bP+q\x1b\\\r\b\x7f\x00\x01\x0b\x0c"
XML_SAFE = f"evil {C1}\x7f{BIDI}{UNSEEN}{SEPARATORS} [red]markup[/red] [link=http://evil]x[/link] :smile:"
HOSTILE = f"{XML_SAFE}{SEQUENCES}"

OWN = re.compile(r"\x1b\[[0-9;]*m|\x1b\[\?25[lh]|\x1b\[1A|\x1b\[2K|\r")
"""What rich writes on a terminal for our colours and bars."""


def hidden(text: str) -> set[str]:
    """The characters that a terminal does not show as themselves, by their Unicode category."""
    return {
        f"U+{ord(c):04X}"
        for c in text
        if c != "\n" and (unicodedata.category(c) in ("Cc", "Cf", "Cs", "Cn", "Zl", "Zp") or c in UNSEEN)
    }


def in_a_pipe(arguments: Sequence[str | Path], cwd: Path) -> str:
    command = [sys.executable, "-P", "-m", "bench.cli", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, check=False, cwd=cwd, timeout=300)
    return (done.stdout + done.stderr).decode(errors="surrogateescape")


def on_a_tty(arguments: Sequence[str | Path], cwd: Path) -> str:
    ours, theirs = pty.openpty()
    command = [sys.executable, "-P", "-m", "bench.cli", *map(str, arguments)]
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "160"}
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, cwd=cwd, env=environment):
        os.close(theirs)
        found = b""
        with suppress(OSError):  # EIO: all who had it open are gone
            while read := os.read(ours, 1 << 16):
                found += read
    os.close(ours)
    return found.decode(errors="surrogateescape")


def check_harmless(arguments: Sequence[str | Path], cwd: Path, *, shows: bool = True) -> str:
    """Run a command both ways; return what it said in a pipe. `shows`: it has hostile text to show."""
    piped = in_a_pipe(arguments, cwd)
    assert hidden(piped) == set(), piped
    for written in [*cwd.glob("x.*")]:
        written.unlink()
    drawn = on_a_tty(arguments, cwd)
    assert hidden(OWN.sub("", drawn)) == set(), repr(drawn)
    # The colours are ours, not those of the hostile text.
    assert not re.search(r"\x1b\[[0-9;]*mRED", drawn), repr(drawn)
    if shows:
        assert "evil" in piped
        assert "\\x9b" in piped
        assert "evil" in OWN.sub("", drawn)
    return piped


@pytest.fixture(scope="module")
def hostile_log(tmp_path_factory) -> Path:
    """A run's log, all of its strings hostile but those by which it is known to be one."""
    folder = tmp_path_factory.mktemp("hostile")
    good, log = make_log(folder / "good.mcap", 0.05, 1), folder / "log.mcap"
    with good.open("rb") as source, log.open("wb") as target:
        writer = Writer(target)
        writer.start("platoon", HOSTILE)
        schemas: dict[int, int] = {}
        channels: dict[int, list[int]] = {}

        def take(schema: Schema | None, channel: Channel) -> list[int]:
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                # A table's channel says the units of its columns.
                about = {key: HOSTILE if key.startswith("unit") else value for key, value in channel.metadata.items()}
                topics = [channel.topic, f"{channel.topic}{HOSTILE}"]
                number = schemas[schema.id] if schema else 0
                channels[channel.id] = [
                    writer.register_channel(topic, channel.message_encoding, number, {**about, HOSTILE: HOSTILE})
                    for topic in topics
                ]
            return channels[channel.id]

        reader = NonSeekingReader(source)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            for number in take(schema, channel):
                writer.add_message(number, message.log_time, message.data, message.publish_time)
        source.seek(0)
        for attachment in NonSeekingReader(source).iter_attachments():
            # Units, comments and names of values in a DBC file.
            data = attachment.data.replace(b'"m/s"', '"m/s\x1b[31mRED\x9b evil \u202e"'.encode())
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, data)
        writer.add_attachment(0, 0, HOSTILE, "text/plain", b"")
        source.seek(0)
        for metadata in NonSeekingReader(source).iter_metadata():
            assert isinstance(metadata, Metadata)
            changed = {HOSTILE: HOSTILE, f"version {HOSTILE}": HOSTILE}
            for key, value in metadata.metadata.items():
                changed[key] = value if key in ("vehicles", "status", "scenario") else HOSTILE
            changed |= {"reason": f"{HOSTILE}\nplatoon: forged"} if metadata.name == "result" else {}
            writer.add_metadata(metadata.name, changed)
        writer.finish()
    return log


@pytest.mark.parametrize(
    ("arguments", "shows"),
    [
        (["metrics", "LOG"], False),
        (["metrics", "LOG", "--json"], False),
        (["report", "LOG", "-o", "r.html"], False),
        (["report", "LOG", "LOG", "-o", "r.html"], False),
        (["diff", "LOG", "GOOD"], True),
        (["diff", "GOOD", "LOG"], True),
        (["resim", "LOG", "--all"], False),
        (["resim", "LOG", "--ecu", HOSTILE.replace("\x00", "")], True),
        (["replay", "LOG", "--speed", "max"], True),
        (["log", "info", "LOG"], True),
        (["log", "info", "LOG", "--json"], False),
        (["log", "signals", "LOG"], True),
        (["log", "signals", "LOG", "--ranges"], True),
        (["log", "export", "LOG", "-o", "x.asc"], True),
        (["log", "export", "LOG", "-o", "x.log"], True),
        (["log", "export", "LOG", "-o", "x.csv"], False),
        (["log", "recover", "LOG", "-o", "x.mcap"], False),
        (["log", "layout", "LOG"], False),
    ],
    ids=lambda value: " ".join(value)[:30].encode("ascii", "ignore").decode() if isinstance(value, list) else "",
)
def test_a_log_controls_no_terminal(hostile_log, tmp_path, arguments, shows):
    named = {"LOG": hostile_log, "GOOD": hostile_log.with_name("good.mcap")}
    commands = [named.get(argument, argument) for argument in arguments]
    assert "Traceback" not in check_harmless(commands, tmp_path, shows=shows)


def test_json_keeps_foreign_text_exactly(hostile_log, tmp_path):
    found = json.loads(in_a_pipe(["log", "info", hostile_log, "--json"], tmp_path))
    assert found["metadata"][HOSTILE] == HOSTILE
    assert HOSTILE in found["attachments"]


def test_lines_of_a_value_stay_in_its_column(hostile_log, tmp_path):
    assert "\nplatoon: forged" not in in_a_pipe(["log", "info", hostile_log], tmp_path)


@pytest.fixture
def hostile_fmu(tmp_path) -> Path:
    """An FMU's description; XML takes no C0 but the tab and line breaks."""
    path = tmp_path / "Evil.fmu"
    text = XML_SAFE.replace("[", "&#91;")
    description = f"""<?xml version="1.0" encoding="UTF-8"?>
    <fmiModelDescription fmiVersion="3.0" modelName="{text}" instantiationToken="{text}" generationTool="{text}"
        description="{text}" version="{text}" author="{text}" generationDateAndTime="{text}">
      <CoSimulation modelIdentifier="evil"/>
      <UnitDefinitions><Unit name="{text}"><BaseUnit K="1"/><DisplayUnit name="{text}"/></Unit></UnitDefinitions>
      <TypeDefinitions>
        <EnumerationType name="Mode"><Item name="{text}" value="1"/></EnumerationType>
      </TypeDefinitions>
      <ModelVariables>
        <Float64 name="x{text}" valueReference="1" causality="output" unit="{text}" description="{text}&#10;two"/>
        <Enumeration name="m{text}" valueReference="2" causality="parameter" declaredType="Mode" start="1"/>
        <String name="s{text}" valueReference="3" causality="parameter"><Start value="{text}"/></String>
      </ModelVariables>
      <ModelStructure><Output valueReference="1"/></ModelStructure>
    </fmiModelDescription>"""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.writestr(f"binaries/x86_64-linux{BIDI}/evil.so", b"")
    return path


@pytest.mark.parametrize("command", [["info"], ["info", "--json"], ["validate"], ["report"]], ids=" ".join)
def test_an_fmu_controls_no_terminal(hostile_fmu, tmp_path, command):
    check_harmless(["fmu", command[0], hostile_fmu, *command[1:]], tmp_path, shows=command == ["info"])


@pytest.mark.parametrize(
    "text",
    [
        'name = "KEY"\n',
        'description = "KEY"\n"KEY" = "KEY"\n[platoon]\nlane_y_m = "KEY"\n["a KEY"]\nb = 1\n',
        '[[faults]]\nkind = "KEY"\n"KEY" = 1\n[[vehicles]]\n"KEY" = "KEY"\n[buses]\n"KEY" = "KEY"\n',
        "KEY \x1b]0;title\x07 = 1\n",
        "name = 'KEY\x9b31m'\n= = =\n",
    ],
)
def test_a_scenario_controls_no_terminal(tmp_path, text):
    key = "".join(f"\\u{ord(c):04x}" if ord(c) < 0x10000 else f"\\U{ord(c):08x}" for c in HOSTILE)
    (tmp_path / "evil.toml").write_text(text.replace("KEY", key))
    assert "Traceback" not in check_harmless(["run", "evil.toml"], tmp_path, shows=False)


ECU = """
    import sys

    sys.path.insert(0, {folder!r})
    from simple import SpeedTracker


    class Evil(SpeedTracker):
        def step(self, *given):
            sys.stderr.write({text!r})
            sys.stdout.write({text!r})
            raise RuntimeError({text!r} + "\\ud800")
"""


@pytest.mark.parametrize("can", ["direct", "udp"])
def test_what_an_ecu_says_controls_no_terminal(tmp_path, can):
    source = textwrap.dedent(ECU).format(text=HOSTILE, folder=str(ROOT / "tests" / "ecus"))
    (tmp_path / "evil.py").write_text(source, encoding="utf-8", errors="surrogatepass")
    short = ["--set", "duration_s=0.05", "--no-report"]
    said = check_harmless(["run", "--can", can, "--ecu", "tracker=evil.py:Evil", *short], tmp_path)
    assert "\\x1b[31mRED\\x1b[0m" in said


@pytest.mark.parametrize("command", [["log", "info"], ["metrics"], ["run"], ["resim", "--all"], ["fmu", "info"]])
def test_a_file_name_controls_no_terminal(tmp_path, command):
    # The name of a file is bytes; these are no UTF-8, and C1 controls to a terminal in Latin-1.
    name = os.fsdecode(b"evil\x9b31m\x1b]0;title\x07\xe2\x80\xae\nplatoon: forged.mcap")
    (tmp_path / name).write_bytes(b"no log")
    said = check_harmless([*command, name], tmp_path, shows=False)
    assert "evil\\udc9b31m\\x1b]0;title" in said
    assert "forged" in said
    assert "\nplatoon: forged" not in said


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "--set", "x\nplatoon: forged"],
        ["run", "--can", "x\nplatoon: forged"],
        ["run", "--ecu", "tracker=x\nplatoon: forged.py:A"],
        ["run", "x\nplatoon: forged"],
        ["fmu", "info", "x\nplatoon: forged"],
        ["fault", "bus_off", "--run", "x\nplatoon: forged"],
    ],
    ids=lambda arguments: " ".join(arguments[:2]),
)
def test_no_line_of_an_argument_looks_like_a_message(tmp_path, arguments):
    said = check_harmless(arguments, tmp_path, shows=False)
    assert "forged" in said
    assert "\nplatoon: forged" not in said


@pytest.mark.parametrize("arguments", [["\x1b]0;title\x07"], ["run", "--\x1b[31mRED"], ["run", "--seed", "\x9b31mRED"]])
def test_an_argument_controls_no_terminal(tmp_path, arguments):
    check_harmless(arguments, tmp_path, shows=False)


def test_frames_of_other_tools_control_no_terminal(tmp_path):
    (tmp_path / "evil.log").write_text(f"(0.0) {'evil' + SEQUENCES.replace(' ', '')} 123#00\n(1.0) \x1b[31mRED 1#\n")
    (tmp_path / "evil.dbc").write_text(f'VERSION "{HOSTILE}"\nBO_ {HOSTILE}\n')
    check_harmless(["log", "import", "evil.log", "-o", "a.mcap"], tmp_path, shows=False)
    check_harmless(["log", "import", "evil.log", "-o", "b.mcap", "--dbc", "evil.dbc"], tmp_path, shows=False)


@pytest.mark.parametrize("command", [["doctor"], ["scenarios"], ["scenarios", "five"], ["fault"], ["--help"], ["run"]])
def test_what_is_ours_needs_no_escape(tmp_path, command):
    said = in_a_pipe([*command, *(["--help"] if command == ["run"] else [])], tmp_path)
    assert hidden(said) == set()
    assert "\\x" not in said
    assert "\\u" not in said


def test_our_colours_stay_on_a_terminal(tmp_path):
    assert "\x1b[32mok" in on_a_tty(["doctor"], tmp_path)
    assert "\x1b[1m" in on_a_tty(["--help"], tmp_path)


def test_text_is_escaped_as_python_writes_it():
    assert escaped("\x1b[31m") == "\\x1b[31m"
    assert escaped("\u202e\ud800\x85\t|") == "\\u202e\\ud800\\x85 |"
    assert escaped("one\ntwo γ − ü 漢 😀") == "one\ntwo γ − ü 漢 😀"
    assert one_line("one\ntwo") == "one\\ntwo"


def test_long_lines_are_cut_and_say_so():
    assert shown("x" * LONGEST_LINE) == "x" * LONGEST_LINE
    assert shown("a\n" + "x" * (LONGEST_LINE + 7)) == "a\n" + "x" * LONGEST_LINE + " ... (7 characters more)"

"""Logs of other tools: export of frames to candump, ASC, BLF and MF4 files, and import, through python-can."""

from bench.record.exchange.export import Exported, export_log
from bench.record.exchange.formats import Format
from bench.record.exchange.importing import Imported, import_logs

__all__ = ["Exported", "Format", "Imported", "export_log", "import_logs"]

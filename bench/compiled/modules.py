"""The names of the hot modules, which are compiled: what each cycle of a run goes through."""

COMPILED: tuple[str, ...] = (
    "bench.bus.absence",
    "bench.bus.e2e",
    "bench.bus.inbox",
    "bench.bus.layout",
    "bench.bus.link.direct",
    "bench.bus.outbox",
    "bench.bus.quantities",
    "bench.bus.sync",
    "bench.bus.wire.frame_length",
    "bench.bus.wire.timing",
    "bench.control.matrices",
    "bench.ecu.checks",
    "bench.ecu.limits",
    "bench.ecu.plausibility",
    "bench.ecu.runtime",
    "bench.ecu.sent_values",
    "bench.ecu.tracker",
    "bench.mcap.records",
    "bench.record.can_frame",
    "bench.record.signals",
)

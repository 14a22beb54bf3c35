"""The protocol's tables as C headers: parameters and their ids, counters, messages, and the links' bit rates."""

from __future__ import annotations

from collections.abc import Iterator

from goldfield_protocol.messages import shapes
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES
from goldfield_protocol.table import COUNTERS, PARAMETERS, ROLES, Parameter


def ids_header() -> str:
    """Return ``parameter_ids.h``: the id of each parameter and the shape of each array."""
    lines = []
    for parameter in PARAMETERS.values():
        macro = f"PARAMETER_{parameter.name.upper()}"
        lines.append(f"#define {macro} {parameter.first}u")
        if parameter.count > 1:
            lines.append(f"#define {macro}_ELEMENTS {parameter.group}u")
        if parameter.rows > 1:
            lines += [f"#define {macro}_ROWS {parameter.rows}u", f"#define {macro}_STRIDE {parameter.stride}u"]
    lines += ["/* Number of elements of all parameters. */"]
    lines += [f"#define PARAMETERS_COUNT {sum(p.count for p in PARAMETERS.values())}u"]
    lines += ["/* Number of their rows: runs of successive ids, of which a single parameter is one. */"]
    lines += [f"#define PARAMETERS_RUNS {sum(p.rows for p in PARAMETERS.values())}u"]
    return _guarded("PARAMETER_IDS_H", lines)


def counters_header() -> str:
    """Return ``counter_ids.h``: the index of each counter."""
    lines = [f"    COUNTER_{c.identifier.upper()} = {c.index}, /* {c.text} */" for c in COUNTERS]
    return _guarded("COUNTER_IDS_H", ["enum {", *lines, f"    COUNTERS_COUNT = {len(COUNTERS)}", "};"])


def table_header() -> str:
    """Return ``parameter_table.h``: the constants of ``parameters.c``, which includes it behind ``parameters.h``."""
    entries = [_entry(parameter) for parameter in PARAMETERS.values()]
    defaults = [line for parameter in PARAMETERS.values() for line in _odd_defaults(parameter)]
    lines = ["static const parameter_entry_t parameter_table[] = {", *entries, "};"]
    lines += ["/* Defaults of elements that differ from that of the parameter's first element. */"]
    lines += ["static const struct {", "    uint16_t id;", "    uint32_t bits;", "} parameter_defaults[] = {"]
    lines += [*defaults, "};"]
    return _guarded("PARAMETER_TABLE_H", lines)


def rates_header() -> str:
    """Return ``link_rates.h``: the bit rates that ``can_rate`` and ``serial_rate`` choose from."""
    lines = ["/* Initialisers of arrays, by the parameter's value. */"]
    for link, rates in (("CAN", CAN_RATES), ("SERIAL", SERIAL_RATES)):
        values = ", ".join(f"{rate}u" for rate in rates)
        lines += [f"#define {link}_RATES_COUNT {len(rates)}u", f"#define {link}_RATES {{{values}}}"]
    return _guarded("LINK_RATES_H", lines, "rates.py")


def messages_header() -> str:
    """Return ``message_table.h``: what the frames of each message have, which ``messages.c`` includes."""
    entries = [
        f"    [{type_}] = {{true, {shape.length}u, {shape.largest_index}u}},"
        for type_, shape in sorted(shapes().items())
    ]
    lines = ["static const message_shape_t message_table[32] = {", *entries, "};"]
    return _guarded("MESSAGE_TABLE_H", lines, "goldfield.dbc")


def _guarded(guard: str, lines: list[str], source: str = "parameters.toml") -> str:
    return (
        f"/* Generated from {source}. */\n"
        + "\n".join([f"#ifndef {guard}", f"#define {guard}", *lines, "#endif"])
        + "\n"
    )


def _word(parameter: Parameter, value: int | float) -> str:
    """Return the 32 bits of a value."""
    return f"{int.from_bytes(parameter.pack(value), 'little'):#x}u"


def _entry(parameter: Parameter) -> str:
    roles = sum(1 << ROLES[role] for role in parameter.roles)
    text = f"{parameter.name} {parameter.unit}".rstrip()
    fields = [
        *(f"{parameter.first}u", f"PARAMETER_{parameter.kind.name}", str(int(parameter.at_start)), f"{roles:#x}u"),
        *(f"{n}u" for n in (parameter.group, parameter.rows, parameter.stride, parameter.excluded or 0)),
        *(_word(parameter, value) for value in (parameter.low, parameter.high, parameter.default[0])),
        f'"{text}"',
    ]
    return f"    {{{', '.join(fields)}}},"


def _odd_defaults(parameter: Parameter) -> Iterator[str]:
    """Yield the defaults of elements that differ from the first one's."""
    for element in range(parameter.count):
        value = parameter.default[element % parameter.group]
        if value != parameter.default[0]:
            yield f"    {{{parameter.identifier(element)}u, {_word(parameter, value)}}},"

"""A database as AUTOSAR 4.2 has it, which cantools reads and does not write."""

from cantools.database.can import Database, Message, Signal

HEAD = '<AUTOSAR xmlns="http://autosar.org/schema/r4.0" schemaLocation="AUTOSAR_4-2-2.xsd">'


def as_arxml(database: Database) -> str:
    """Every message with its signals; a signal is called by its name and that of its message."""
    messages = database.messages
    pairs = [(message, signal) for message in messages for signal in message.signals]
    packages = {
        "Cluster": _cluster(messages),
        "Frame": "".join(map(_frame, messages)),
        "Pdu": "".join(map(_pdu, messages)),
        "Signal": "".join(_i_signal(*pair) for pair in pairs),
        "SystemSignal": "".join(_system_signal(*pair) for pair in pairs),
        "Compu": "".join(_compu_method(*pair) for pair in pairs),
        "Type": "".join(_base_type(*pair) for pair in pairs),
    }
    body = "".join(
        f"<AR-PACKAGE><SHORT-NAME>{name}</SHORT-NAME><ELEMENTS>{elements}</ELEMENTS></AR-PACKAGE>\n"
        for name, elements in packages.items()
    )
    return f'<?xml version="1.0"?>\n{HEAD}<AR-PACKAGES>\n{body}</AR-PACKAGES></AUTOSAR>\n'


def name_of(message: str, signal: str) -> str:
    """What ``as_arxml`` calls a signal: names in a package are unique."""
    return f"{signal}_of_{message}"


def _element(tag: str, name: str, body: str) -> str:
    return f"<{tag}><SHORT-NAME>{name}</SHORT-NAME>{body}</{tag}>"


def _reference(tag: str, path: str) -> str:
    return f'<{tag}-REF DEST="{tag}">/{path}</{tag}-REF>'


def _properties(tag: str, body: str) -> str:
    inner = f"<SW-DATA-DEF-PROPS-CONDITIONAL>{body}</SW-DATA-DEF-PROPS-CONDITIONAL>"
    return f"<{tag}><SW-DATA-DEF-PROPS-VARIANTS>{inner}</SW-DATA-DEF-PROPS-VARIANTS></{tag}>"


def _cluster(messages: list[Message]) -> str:
    triggerings = "".join(
        _element(
            "CAN-FRAME-TRIGGERING",
            message.name,
            f'<FRAME-REF DEST="CAN-FRAME">/Frame/{message.name}</FRAME-REF>'
            f"<CAN-ADDRESSING-MODE>{'EXTENDED' if message.is_extended_frame else 'STANDARD'}"
            f"</CAN-ADDRESSING-MODE><IDENTIFIER>{message.frame_id}</IDENTIFIER>",
        )
        for message in messages
    )
    channel = _element(
        "CAN-PHYSICAL-CHANNEL", "A", f"<FRAME-TRIGGERINGS>{triggerings}</FRAME-TRIGGERINGS>"
    )
    channels = f"<PHYSICAL-CHANNELS>{channel}</PHYSICAL-CHANNELS>"
    variant = f"<CAN-CLUSTER-CONDITIONAL>{channels}</CAN-CLUSTER-CONDITIONAL>"
    variants = f"<CAN-CLUSTER-VARIANTS>{variant}</CAN-CLUSTER-VARIANTS>"
    return _element("CAN-CLUSTER", "Chassis", variants)


def _frame(message: Message) -> str:
    mapping = _element(
        "PDU-TO-FRAME-MAPPING",
        message.name,
        f'<PDU-REF DEST="I-SIGNAL-I-PDU">/Pdu/{message.name}</PDU-REF>'
        "<START-POSITION>0</START-POSITION>",
    )
    mappings = f"<PDU-TO-FRAME-MAPPINGS>{mapping}</PDU-TO-FRAME-MAPPINGS>"
    length = f"<FRAME-LENGTH>{message.length}</FRAME-LENGTH>"
    return _element("CAN-FRAME", message.name, length + mappings)


def _pdu(message: Message) -> str:
    orders = {"big_endian": "MOST-SIGNIFICANT-BYTE-FIRST"}
    mappings = "".join(
        _element(
            "I-SIGNAL-TO-I-PDU-MAPPING",
            signal.name,
            _reference("I-SIGNAL", f"Signal/{name_of(message.name, signal.name)}")
            + f"<PACKING-BYTE-ORDER>{orders.get(signal.byte_order, 'MOST-SIGNIFICANT-BYTE-LAST')}"
            f"</PACKING-BYTE-ORDER><START-POSITION>{signal.start}</START-POSITION>",
        )
        for signal in message.signals
    )
    return _element(
        "I-SIGNAL-I-PDU",
        message.name,
        f"<LENGTH>{message.length}</LENGTH>"
        f"<I-SIGNAL-TO-PDU-MAPPINGS>{mappings}</I-SIGNAL-TO-PDU-MAPPINGS>",
    )


def _i_signal(message: Message, signal: Signal) -> str:
    name = name_of(message.name, signal.name)
    return _element(
        "I-SIGNAL",
        name,
        f"<LENGTH>{signal.length}</LENGTH>"
        + _properties(
            "NETWORK-REPRESENTATION-PROPS",
            f'<BASE-TYPE-REF DEST="SW-BASE-TYPE">/Type/{name}</BASE-TYPE-REF>',
        )
        + _reference("SYSTEM-SIGNAL", f"SystemSignal/{name}"),
    )


def _system_signal(message: Message, signal: Signal) -> str:
    name = name_of(message.name, signal.name)
    method = _reference("COMPU-METHOD", f"Compu/{name}")
    return _element("SYSTEM-SIGNAL", name, _properties("PHYSICAL-PROPS", method))


def _compu_method(message: Message, signal: Signal) -> str:
    """Offset first, then the factor."""
    numbers = f"<V>{signal.offset!r}</V><V>{signal.scale!r}</V>"
    above, below = "COMPU-NUMERATOR", "COMPU-DENOMINATOR"
    ratio = f"<{above}>{numbers}</{above}><{below}><V>1</V></{below}>"
    scale = f"<COMPU-SCALE><COMPU-RATIONAL-COEFFS>{ratio}</COMPU-RATIONAL-COEFFS></COMPU-SCALE>"
    scales = f"<COMPU-SCALES>{scale}</COMPU-SCALES>"
    return _element(
        "COMPU-METHOD",
        name_of(message.name, signal.name),
        f"<CATEGORY>LINEAR</CATEGORY><COMPU-INTERNAL-TO-PHYS>{scales}</COMPU-INTERNAL-TO-PHYS>",
    )


def _base_type(message: Message, signal: Signal) -> str:
    coding = "2C" if signal.is_signed else "NONE"
    return _element(
        "SW-BASE-TYPE",
        name_of(message.name, signal.name),
        f"<BASE-TYPE-SIZE>{signal.length}</BASE-TYPE-SIZE>"
        f"<BASE-TYPE-ENCODING>{coding}</BASE-TYPE-ENCODING>",
    )

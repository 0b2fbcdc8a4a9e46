

_KINDS = {
    ctypes.c_uint8: "u8",
    ctypes.c_uint16: "u16",
    ctypes.c_uint32: "u32",
    ctypes.c_uint64: "u64",
    ctypes.c_int32: "i32",
    ctypes.c_double: "f64",
}


def layouts():
    """The fields of all samples as ctypes lays them out: (topic, field, kind, count, size, offset).

    A struct comes before its fields, of an array the first element stands for all, and "." is a sample as a whole.
    """
    rows = []

    def add(topic, around, start, structure):
        for name, kind in structure._fields_:
            offset = start + getattr(structure, name).offset
            count = 1
            if issubclass(kind, ctypes.Array):
                kind, count = kind._type_, kind._length_
            rows.append((topic, around + name, _KINDS.get(kind, kind.__name__), count, ctypes.sizeof(kind), offset))
            if issubclass(kind, ctypes.Structure):
                add(topic, around + name + ".", offset, kind)

    for topic, sample in TOPICS.items():
        rows.append((topic, ".", sample.type_name(), 1, ctypes.sizeof(sample), 0))
        add(topic, "", 0, sample)
    return rows

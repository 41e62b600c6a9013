"""Definitions of ROS 2 messages in IDL, made from the types that `rosbags` knows."""

import logs_maker as make

_IDL_NAMES = {"bool": "boolean", "float32": "float", "float64": "double"}


def idl(kind: str) -> str:
    """The definition of a type in IDL, as ROS 2 generates it: sections, comments, annotations, typedefs of arrays."""
    todo, texts = [kind], dict[str, str]()
    while todo:
        name = todo.pop()
        if name in texts:
            continue
        package, _, short = name.split("/")
        constants, fields = make.typestore().fielddefs[name]
        lines, typedefs = [], []
        for field_name, (node, content) in fields:
            is_array = node.name in ("ARRAY", "SEQUENCE")
            inner, size = content if is_array else ((node, content), 0)
            if inner[0].name == "NAME":
                todo.append(inner[1])
                written = inner[1].replace("/", "::")
            else:
                written = _IDL_NAMES.get(inner[1][0], inner[1][0])
            if node.name == "SEQUENCE":
                written = f"sequence<{written}>"
            elif node.name == "ARRAY":
                typedefs.append(f"    typedef {written} {written}__{size}[{size}];")
                written = f"{written}__{size}"
            lines.append(f'      @verbatim (language="comment", text=\n        "what (it) \\"is\\"; {field_name}")')
            lines.append(f"      {written} {field_name};\n")
        body = "\n".join([*typedefs, f"    struct {short} {{", *lines, "    };"])
        if constants:
            listed = "\n".join(f"      const octet {name} = 1;" for name, *_ in constants)
            body = f"    module {short}_Constants {{\n{listed}\n    }};\n{body}"
        head = f'// generated\n#include "{package}/msg/Other.idl"\n\nmodule {package} {{\n  module msg {{\n'
        texts[name] = f"{head}{body}\n  }};\n}};\n"
    return "".join(f"{'=' * 80}\nIDL: {name}\n{text}" for name, text in texts.items())

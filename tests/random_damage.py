"""Random damage to the bytes of a file."""

from hypothesis import strategies as st

SNIPPETS = [b'"', b",", b";", b"\n", b"\r\n", b"\x00", b"e", b"-", b".", b"\xef\xbb\xbf", b"nan"]
SNIPPETS += [b"1e308", b"\n\n", b": ", b"[", b"{", b"&a ", b"*a", b"!!x ", b"\t", b"#", b"'"]


@st.composite
def damages(draw: st.DrawFn) -> list[tuple[str, float, bytes]]:
    """A few changes: what, where (as a share of the length), with which bytes."""
    kinds = st.sampled_from(["truncate", "flip", "insert", "delete", "double"])
    new = st.one_of(st.sampled_from(SNIPPETS), st.binary(min_size=1, max_size=6))
    return draw(st.lists(st.tuples(kinds, st.floats(0, 0.999), new), min_size=1, max_size=3))


def apply_damages(content: bytes, changes: list[tuple[str, float, bytes]]) -> bytes:
    for kind, share, new in changes:
        i = int(share * len(content))
        head, tail = content[:i], content[i:]
        if kind == "truncate":
            content = head
        elif kind == "flip":
            content = head + new[:1] + tail[1:]
        elif kind == "insert":
            content = head + new + tail
        elif kind == "delete":
            content = head + tail[7 * len(new) :]
        else:
            content = head + tail[: 9 * len(new)] + tail
    return content

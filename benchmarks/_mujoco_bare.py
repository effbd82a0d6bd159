"""MJCF without what is there to be seen and measured, for fair times of its dynamics."""

from xml.etree import ElementTree as ET


def bare(mjcf: str) -> str:
    """The same model without tendons, which draw the struts, and without sensors."""
    root = ET.fromstring(mjcf)
    for name in ("tendon", "sensor"):
        for element in root.findall(name):
            root.remove(element)
    return ET.tostring(root, encoding="unicode")

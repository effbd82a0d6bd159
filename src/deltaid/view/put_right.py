"""All that an identification put right, found and left out, as tables."""

from deltaid.model.record import IdentifiedModel
from deltaid.view.corrections import correction_table
from deltaid.view.events import event_table
from deltaid.view.fitted_sensors import sensor_tables
from deltaid.view.left_out import left_out_table
from deltaid.view.loads import load_table
from deltaid.view.table import Table


def put_right_tables(model: IdentifiedModel, most_events: int) -> tuple[Table, ...]:
    """Corrections, loads, sensors, events and what was left out, as far as there are any."""
    sources = model.sources
    tables = (
        correction_table(model.corrections),
        load_table(model.loads),
        *sensor_tables(model.sensors),
        event_table(((source.log, source.events) for source in sources), most_events),
        left_out_table((source.log, source.left_out) for source in sources),
    )
    return tuple(table for table in tables if table is not None)

"""Columns: numpy arrays of equal length under their names, and the same as tables of other packages."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas
    import pyarrow

Columns = dict[str, np.ndarray]


def columns_of(rows: Iterable[Mapping[str, Any]]) -> Columns:
    """Rows with the same fields as columns."""
    rows = list(rows)
    return {name: np.array([row[name] for row in rows]) for name in (rows[0] if rows else ())}


def to_pandas(columns: Columns) -> "pandas.DataFrame":
    """A pandas.DataFrame; raises ImportError naming what to install."""
    try:
        import pandas
    except ImportError:
        raise ImportError("to_pandas() needs pandas: pip install pandas; columns() gives numpy arrays") from None
    return pandas.DataFrame(columns)


def to_arrow(columns: Columns) -> "pyarrow.Table":
    """A pyarrow.Table; raises ImportError naming what to install."""
    try:
        import pyarrow
    except ImportError:
        raise ImportError("to_arrow() needs pyarrow: pip install pyarrow; columns() gives numpy arrays") from None
    return pyarrow.table(columns)

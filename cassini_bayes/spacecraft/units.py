"""Units that the printed tables and telemetry have beside SI ones."""

from __future__ import annotations

from typing import Final

import numpy as np

RAD_S_PER_RPM: Final = 2.0 * np.pi / 60.0
RPM_PER_RAD_S: Final = 60.0 / (2.0 * np.pi)
YEAR_S: Final = 365.25 * 86_400.0

"""What was measured: totals rows and telemetry, read, checked and made plausible."""

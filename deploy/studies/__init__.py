"""Studies: paired trials, their tables, figures and tests, and the robustness study."""

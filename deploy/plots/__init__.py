"""Figures for papers: of one run, of a study, of the robustness study."""

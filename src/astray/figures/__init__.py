"""Figures: charts of measured values, and pictures with overlays."""

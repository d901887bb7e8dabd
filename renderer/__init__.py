"""Renders scenes with tabulated and analytic materials, and draws what people look at."""

"""STEP and IGES parts through OpenCASCADE."""

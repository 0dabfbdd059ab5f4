"""Mitsuba and Dr.Jit: back-end gate, scene upload, label pass, radiance pass, sensor."""

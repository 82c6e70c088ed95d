"""Robots whose steps cost by the slope that they lead up or down."""

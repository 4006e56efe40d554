"""Learning-augmented land-vehicle navigation in PyTorch.

The contract that every module keeps:

* **Units** are SI and radians, without suffix; anything else says so in its name
  (``lat_deg``, ``speed_kmh``). Geodetic quantities are float64.
* **Local-level frame** ``l`` is ENU (east, north, up). **Body frame** ``b`` is RFU
  (x right, y forward, z up). Logs in other axes are turned by their reader.
* **Azimuth** is that of the forward axis, clockwise from north; **yaw rate** is the z gyro,
  positive in a left turn; **pitch** is positive nose up, **roll** right side down.
* **Specific force** parked and level is (0, 0, +g).
* ``C_lb`` turns body into local level: touching letters cancel in ``f_l = C_lb @ f_b``.
* **Error** is estimate minus reference: a correction is subtracted.
* **Time** is seconds from the start of the log, float64, strictly increasing.
* **Shapes** put the batch first and time next to last or last: ``(..., T)`` for one
  channel, ``(..., T, n)`` for several.
* **Tables** are pandas frames with the columns of ``navlearn.logs.columns``.
"""

__version__ = "0.1.0"

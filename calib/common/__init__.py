"""What all methods of calibration share: rows, noise, covariance, the record, its file and the verdict."""

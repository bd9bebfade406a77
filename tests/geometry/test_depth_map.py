import numpy as np

from mvsam.geometry.depth_map import from_millimetres, to_millimetres


def test_metres_become_the_nearest_whole_millimetres():
    depth = np.array([[0.0, 0.0004, 1.2344], [1.2346, 65.535, 100.0]], np.float32)
    millimetres = to_millimetres(depth)
    assert millimetres.dtype == np.uint16
    assert millimetres.tolist() == [[0, 0, 1234], [1235, 65535, 65535]]


def test_every_millimetre_comes_back_as_itself():
    millimetres = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    depth = from_millimetres(millimetres)
    assert depth.dtype == np.float32 and depth[0, 5] == np.float32(0.005)
    np.testing.assert_array_equal(to_millimetres(depth), millimetres)

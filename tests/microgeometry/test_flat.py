def test_flat_is_exactly_flat(tile_of):
    tile = tile_of("flat", size=3, units="mm")
    assert not tile.heights.any()
    assert tile.size == (3e-3, 3e-3)
    stats = tile.statistics()
    assert (stats.alpha, stats.rms_height, stats.area_ratio) == (0.0, 0.0, 1.0)

prt_test(cache SOURCES unit/cache.c LIBS relightd_rooms LABELS unit)

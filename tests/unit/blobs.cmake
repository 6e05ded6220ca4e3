prt_test(blobs SOURCES unit/blobs.c LIBS relightd_rooms LABELS unit)

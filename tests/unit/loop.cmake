prt_test(loop SOURCES unit/loop.c LIBS relightd_rooms LABELS unit TIMEOUT 60)

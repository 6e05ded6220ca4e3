prt_test(room_fold SOURCES unit/room_fold.c LIBS relightd_rooms LABELS unit)

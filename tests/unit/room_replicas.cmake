prt_test(room_replicas SOURCES unit/room_replicas.c LIBS relightd_rooms LABELS unit)

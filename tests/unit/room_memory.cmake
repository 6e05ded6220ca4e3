prt_test(room_memory SOURCES unit/room_memory.c LIBS relightd_rooms LABELS unit)

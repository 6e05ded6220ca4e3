prt_test(room_state SOURCES unit/room_state.c LIBS relightd_rooms LABELS unit TIMEOUT 60)

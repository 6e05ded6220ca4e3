# The tests of rooms once more, with a PostgreSQL of their own (skipped where none is installed).
# tests/*/ are read in their order: the programs are made by unit and service.
foreach(name room_store room_life)
  add_test(NAME ${name}_postgres
    COMMAND ${CMAKE_SOURCE_DIR}/deploy/cluster/with_postgres $<TARGET_FILE:test_${name}>)
  set_tests_properties(${name}_postgres PROPERTIES LABELS cluster SKIP_RETURN_CODE 77)
endforeach()
add_test(NAME replicas_rooms COMMAND ${CMAKE_SOURCE_DIR}/deploy/cluster/with_postgres
  ${CMAKE_CURRENT_LIST_DIR}/rooms.sh ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(replicas_rooms PROPERTIES LABELS cluster SKIP_RETURN_CODE 77)
# Two replicas that remove what nobody uses from their folder, with their rooms in PostgreSQL.
add_test(NAME room_keep_postgres COMMAND ${CMAKE_SOURCE_DIR}/deploy/cluster/with_postgres
  /usr/bin/python3 ${CMAKE_SOURCE_DIR}/tests/service/room_keep.py ${CMAKE_BINARY_DIR}/bin check_replicas)
set_tests_properties(room_keep_postgres PROPERTIES LABELS cluster SKIP_RETURN_CODE 77)

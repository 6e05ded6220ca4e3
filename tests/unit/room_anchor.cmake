find_library(CJSON_LIBRARY NAMES cjson REQUIRED)
prt_test(room_anchor SOURCES unit/room_anchor.c ${CMAKE_SOURCE_DIR}/client/cli/room_anchor.c
  LIBS prt_formats ${CJSON_LIBRARY} LABELS unit)
target_include_directories(test_room_anchor PRIVATE ${CMAKE_SOURCE_DIR}/client
  ${CMAKE_SOURCE_DIR}/client/cli ${CMAKE_SOURCE_DIR}/client/include)

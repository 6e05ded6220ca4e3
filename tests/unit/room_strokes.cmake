find_library(CJSON_LIBRARY NAMES cjson REQUIRED)
prt_test(room_strokes SOURCES unit/room_strokes.c ${CMAKE_SOURCE_DIR}/client/cli/room_strokes.c
  LIBS prt_formats ${CJSON_LIBRARY} LABELS unit)
target_include_directories(test_room_strokes PRIVATE ${CMAKE_SOURCE_DIR}/client
  ${CMAKE_SOURCE_DIR}/client/cli ${CMAKE_SOURCE_DIR}/client/include)

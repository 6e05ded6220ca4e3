# Files of one value a vertex; links the room alone, as the client does.
prt_test(vertex_file SOURCES ${CMAKE_CURRENT_LIST_DIR}/vertex_file.c
  LIBS prt_formats ${CJSON_LIBRARY} LABELS unit)

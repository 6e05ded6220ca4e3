prt_test(terminal SOURCES ${CMAKE_CURRENT_LIST_DIR}/terminal.c LIBS prt_formats LABELS unit)
target_include_directories(test_terminal PRIVATE ${CMAKE_SOURCE_DIR}/libprt/formats)

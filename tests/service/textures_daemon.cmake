# Images of a textured model as raw texels and as PNG files, from a live relightd.
find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
add_test(NAME textures_daemon COMMAND ${SYSTEM_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/textures_daemon.py
  ${CMAKE_BINARY_DIR}/bin ${CMAKE_BINARY_DIR}/python)
set_tests_properties(textures_daemon PROPERTIES LABELS service)

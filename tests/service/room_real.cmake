# Pins on a real model, drawn again on every instruction set. The data lies beside the checkout.
find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
add_test(NAME room_real COMMAND ${SYSTEM_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/room_real.py
  ${CMAKE_BINARY_DIR}/bin ${CMAKE_SOURCE_DIR}/../shared/data/models/spot.glb
  ${CMAKE_SOURCE_DIR}/../shared/data/env/latlong/grace.exr)
set_tests_properties(room_real PROPERTIES LABELS service SKIP_RETURN_CODE 77)

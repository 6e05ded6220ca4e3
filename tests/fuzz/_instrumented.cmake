# Second copies of rooms under the address and undefined-behaviour sanitizers, so that every build
# finds memory errors in what reads a client's bytes. In the sanitizer presets the rooms are
# instrumented already and nothing is compiled twice.
include_guard()
set(prt_instrument_flags -fsanitize=address,undefined)

# prt_instrument(ROOM): an object library ROOM_checked of the library's sources.
function(prt_instrument room)
  if(TARGET ${room}_checked)
    return()
  endif()
  if(PRT_SANITIZE)
    add_library(${room}_checked INTERFACE)
    target_link_libraries(${room}_checked INTERFACE ${room})
    return()
  endif()
  get_target_property(sources ${room} SOURCES)
  get_target_property(folder ${room} SOURCE_DIR)
  set(absolute "")
  foreach(source ${sources})
    cmake_path(ABSOLUTE_PATH source BASE_DIRECTORY ${folder})
    list(APPEND absolute ${source})
  endforeach()
  add_library(${room}_checked OBJECT ${absolute})
  add_dependencies(${room}_checked ${room}) # generated sources
  target_include_directories(${room}_checked PRIVATE
    $<TARGET_PROPERTY:${room},INCLUDE_DIRECTORIES>)
  target_compile_definitions(${room}_checked PRIVATE _GNU_SOURCE
    $<TARGET_PROPERTY:${room},COMPILE_DEFINITIONS>)
  # The room itself is held to the warnings.
  target_compile_options(${room}_checked PRIVATE -w -O1 -g ${prt_instrument_flags}
    -fno-sanitize-recover=undefined -fno-omit-frame-pointer)
endfunction()

# prt_checked_program(NAME SOURCES a.c ROOMS relightd_rooms relight_proto ... LIBS ...): a program
# with instrumented copies of ROOMS; libraries behind them are linked as they are.
function(prt_checked_program name)
  cmake_parse_arguments(C "" "" "SOURCES;ROOMS;LIBS" ${ARGN})
  add_executable(${name} ${C_SOURCES})
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
  target_link_libraries(${name} PRIVATE prt_options)
  foreach(room ${C_ROOMS})
    prt_instrument(${room})
    target_link_libraries(${name} PRIVATE ${room}_checked)
  endforeach()
  # The rooms themselves bring their libraries; of their own objects the linker takes none, since
  # the copies define everything.
  target_link_libraries(${name} PRIVATE ${C_ROOMS} ${C_LIBS} m)
  if(NOT PRT_SANITIZE)
    target_compile_options(${name} PRIVATE -O1 -g ${prt_instrument_flags}
      -fno-sanitize-recover=undefined -fno-omit-frame-pointer)
    target_link_options(${name} PRIVATE ${prt_instrument_flags})
  endif()
endfunction()

# SPDX-License-Identifier: MIT
# install_configured(FILE FOLDER COMPONENT): configures FILE when it is installed, for the prefix that
# `cmake --install --prefix` or cpack names then, and lays it down in FOLDER. `@CMAKE_INSTALL_FULL_SYSCONFDIR@` and the
# like stand for folders of that prefix, in FILE and in FOLDER: for /usr this one is /etc.
# The second half of this file runs at the installation.
if(NOT DEFINED configured_file)
  function(install_configured file folder component)
    cmake_path(ABSOLUTE_PATH file)
    set(code "set(PROJECT_VERSION \"${PROJECT_VERSION}\")\n")
    foreach(word BINDIR SYSCONFDIR LIBDIR INCLUDEDIR)
      string(APPEND code "set(CMAKE_INSTALL_${word} \"${CMAKE_INSTALL_${word}}\")\n")
    endforeach()
    install(CODE "${code}
      set(configured_file \"${file}\")
      set(configured_folder \"${folder}\")
      set(configured_scratch \"${CMAKE_CURRENT_BINARY_DIR}/installed\")
      include(\"${CMAKE_SOURCE_DIR}/deploy/install_configured.cmake\")" COMPONENT ${component})
  endfunction()
  return()
endif()

cmake_minimum_required(VERSION 3.21)
include(GNUInstallDirs)
foreach(word BINDIR SYSCONFDIR LIBDIR INCLUDEDIR)
  GNUInstallDirs_get_absolute_install_dir(CMAKE_INSTALL_FULL_${word} CMAKE_INSTALL_${word} ${word})
endforeach()
cmake_path(GET configured_file FILENAME name)
string(REGEX REPLACE "\\.in$" "" name "${name}")
configure_file("${configured_file}" "${configured_scratch}/${name}" @ONLY)
string(CONFIGURE "${configured_folder}" folder @ONLY)
cmake_path(ABSOLUTE_PATH folder BASE_DIRECTORY "${CMAKE_INSTALL_PREFIX}")
file(INSTALL "${configured_scratch}/${name}" DESTINATION "${folder}")

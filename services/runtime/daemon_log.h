// What the log of a daemon needs at its start, and what standard error is to it.
//   int main(int argc, char** argv) {
//     OpenStandardStreams();
//     if (std::optional<int> code = ParseDaemonFlags(...)) return *code;
//     if (!flags.check_config) StartLogWriter();
//     BlockSignals();
//     ...
// Without StartLogWriter, as in tools and unit tests, each line is written by the thread that logs.
#ifndef RIPS_SERVICES_RUNTIME_DAEMON_LOG_H_
#define RIPS_SERVICES_RUNTIME_DAEMON_LOG_H_

#include <cstdint>
#include <initializer_list>
#include <string>

#include "absl/strings/string_view.h"
#include "services/runtime/log.h"

namespace rips {

// Opens each of the descriptors 0 to 2 that is closed on /dev/null. Otherwise a socket or a
// database would get the number, and with it what is printed. Writing to such a standard output
// fails with EBADF, as before. Before anything else in every main().
void OpenStandardStreams();

// QueueLog and StartLogThread. From then on nothing that this process writes to standard error
// waits for what reads it:
// - A line of the log goes into a queue; one thread writes the queue to what standard error was. A
//   full queue drops the oldest lines of the lowest level and counts them: LogLinesDropped, and a
//   line in the log when it can be written again.
// - Descriptor 2 is a pipe of this process that does not block, for what glibc and libraries write
//   by themselves. The same thread reads it. What they write while it is full is lost, uncounted.
// - exit() waits for the queue, 1 s at most, and 250 ms while nothing is read. abort() waits 300 ms
//   at most; what was not written by then is lost.
// - An exception that ends the process is logged; one of a thread that could not be started says
//   which limit was reached.
// A thread that is inside write() to a frozen disk cannot be ended by the kernel: such a process
// stays, without doing anything, until the disk is thawed.
void StartLogWriter();

// The first half: descriptors, queue, exit and fork. Starts no thread.
void QueueLog();
// The second: where the first thread must not start before privileges are given up, call it then.
void StartLogThread();

// Lines of the log that were not written, since QueueLog.
uint64_t LogLinesDropped();

// What Log does with a line, whose line break is included.
void WriteLogLine(LogLevel level, std::string line);

// Logs a line of a library, with its place in the library's source if it has one, if the level is
// enabled: 20 at once and then 2 a second of each library; the next line counts those that were
// left out. Any thread.
void LogOfLibrary(LogLevel level, absl::string_view library, absl::string_view text,
                  absl::string_view place = "");

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_DAEMON_LOG_H_

// An LCUS board with two relays at the other end of a pseudo terminal. Test code only.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_FAKE_LCUS_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_FAKE_LCUS_H_

#include <termios.h>

#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "services/runtime/mutex.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {

// Any thread, except Unplug and the end.
class FakeLcus {
 public:
  // To the query.
  enum class Answer { kText, kBytes, kNothing, kGarbage, kFlood, kCut };

  explicit FakeLcus(Answer answer);
  ~FakeLcus() { Unplug(); }
  FakeLcus(const FakeLcus&) = delete;
  FakeLcus& operator=(const FakeLcus&) = delete;

  void Unplug();
  // Lets another process open the line, as the last close of a real one does; this one stays open.
  void EndExclusiveUse();
  // Of the terminal that the driver opens.
  const std::string& path() const { return path_; }
  void set_answer(Answer answer) ABSL_LOCKS_EXCLUDED(mu_);
  // Another process switches relay 1 or 2.
  void Force(int relay, bool on) ABSL_LOCKS_EXCLUDED(mu_);
  bool is_on(int relay) ABSL_LOCKS_EXCLUDED(mu_);
  // How the driver set the line up.
  termios mode() const;

 private:
  void Loop();
  void Switch(const std::string& frame) ABSL_LOCKS_EXCLUDED(mu_);
  std::string Say() ABSL_LOCKS_EXCLUDED(mu_);

  UniqueFd master_, slave_, stop_read_, stop_write_;
  std::string path_;
  Mutex mu_;
  Answer answer_ ABSL_GUARDED_BY(mu_);
  bool relays_[2] ABSL_GUARDED_BY(mu_) = {false, false};
  std::thread thread_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_FAKE_LCUS_H_

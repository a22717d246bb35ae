#include "services/rpc/reading_pace.h"

#include <algorithm>

namespace rips::rpc {

ReadingPace::Next ReadingPace::OnRead(size_t bytes, int64_t took_ns, int64_t now_ns) {
  MutexLock lock(&mu_);
  const int64_t most_ns = limits_.message_ns + static_cast<int64_t>(bytes) * limits_.byte_ns;
  budget_.Charge(std::clamp<int64_t>(took_ns, 0, most_ns));
  last_ns_ = now_ns;
  if (!budget_.Spent(now_ns)) return Next::kRead;
  if (news_ns_ != 0 && now_ns - news_ns_ < limits_.again_ns) return Next::kPause;
  news_ns_ = now_ns;
  return Next::kPauseIsNews;
}

bool ReadingPace::MayRead(int64_t now_ns) {
  MutexLock lock(&mu_);
  return !budget_.Spent(now_ns);
}

bool ReadingPace::Forgotten(int64_t now_ns) const {
  MutexLock lock(&mu_);
  return now_ns - last_ns_ >= limits_.again_ns;
}

std::shared_ptr<ReadingPace> ReadingPaces::Of(const std::string& peer, int64_t now_ns) {
  MutexLock lock(&mu_);
  std::shared_ptr<ReadingPace>& pace = paces_[peer];
  if (pace == nullptr) pace = std::make_shared<ReadingPace>(limits_, now_ns);
  return pace;
}

void ReadingPaces::Prune(int64_t now_ns) {
  MutexLock lock(&mu_);
  absl::erase_if(paces_, [now_ns](const auto& each) {
    return each.second.use_count() == 1 && each.second->Forgotten(now_ns);
  });
}

size_t ReadingPaces::size() const {
  MutexLock lock(&mu_);
  return paces_.size();
}

}  // namespace rips::rpc

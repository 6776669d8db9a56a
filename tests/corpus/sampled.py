def systems(): return []
